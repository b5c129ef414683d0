"""What a flight waits for, in words for the person at the terminal."""

from __future__ import annotations

from follower.flightlog import ControlRecord
from follower.settings import Settings
from follower.supervisor import Reason, State

_TROUBLES = {
    Reason.LINK_SILENT: "the autopilot is silent: look after the link",
    Reason.TELEMETRY_STALE: "attitude or position do not come: look after the link",
    Reason.FRAMES_STALE: "no frames come: look after the camera",
    Reason.CONTROL_LATE: "this computer is too busy",
    Reason.TARGET_UNSEEN: "turn the camera towards the target",
    Reason.NOT_FLYING: "pilot: arm, take off, hover where the camera sees the target",
    Reason.NAVIGATION_POOR: "the autopilot does not know well where it is: wait",
    Reason.BATTERY_LOW: "the battery is too low to begin: land",
    Reason.COCKPIT_LOST: "no page is in control: open it, or take control there",
    Reason.AUTOPILOT_FAILSAFE: "the autopilot is in a failsafe",
}
_CONSENTS = {
    "command": "waiting for the operator's command",
    "rc": "waiting for the switch on the transmitter",
    "terminal": "press Enter to follow",
    "cockpit": "press Allow following on the page",
}
_MODES = {"px4": "OFFBOARD", "ardupilot": "GUIDED"}


def waiting_for(
    record: ControlRecord | None,
    autopilot: str,
    wish: str,
    settings: Settings,
    ending: bool = False,
) -> str:
    """Return what has to happen next, and who has to do it.

    Args:
        record: the newest control step, None before the first.
        autopilot: "px4", "ardupilot" or "unknown".
        wish: the target, in words.
        settings: of the flight.
        ending: the user has ended the flight.
    """
    if record is None or record.vehicle.heartbeat_s is None:
        return "waiting for the autopilot"
    mode = _MODES.get(autopilot, "OFFBOARD or GUIDED")
    if ending:
        still = record.vehicle.armed and record.vehicle.obeys_setpoints
        return f"ending; pilot: leave {mode} to take over" if still else "ending"
    if record.state is State.IDLE:
        return f"looking for {wish}"
    if record.state is State.TRACKING:
        return _TROUBLES.get(record.reason, "")
    if record.state is State.READY:
        if record.reason is Reason.WAITING_FOR_PILOT:
            return f"pilot: switch to {mode}, and it follows"
        return _CONSENTS.get(settings.consent.kind, "")
    if record.state is State.RELEASED:
        return _after_release(record, mode, settings)
    return f"pilot: leave {mode} to take over"


def _after_release(record: ControlRecord, mode: str, settings: Settings) -> str:
    if record.vehicle.obeys_setpoints:
        return f"standing still: pilot, leave {mode} to take over"
    stopped = record.reason is Reason.STOP_REQUESTED
    if settings.consent.kind == "mode" and settings.consent.again == "mode" and not stopped:
        return f"yours; to follow again, fly a mode of your own and go back to {mode}"
    if settings.consent.takes_orders_by("terminal"):
        return "yours; consent (Enter, or on the page) to follow again, Ctrl-C ends"
    return f"yours; {_CONSENTS.get(settings.consent.kind, 'Ctrl-C ends')}"
