"""How far an autopilot is on its way into the air."""

import math
from itertools import takewhile

from follower.flight.log import Event, FlightLog
from follower.flight.supervision.autonomy import AutonomyPhase
from follower.links.connections import ConnectionFailedError
from follower.links.link import Link

_ANSWER_WITHIN_S = 15.0
_SETTLE_WITHIN_S = 90.0
"""A freshly started ArduPilot has a position after 20 to 40 s."""
_AIRBORNE_WITHIN_S = 180.0
_LATELY_S = 5.0
_ASKING = (AutonomyPhase.ARMING, AutonomyPhase.TAKING_OFF)


class AutopilotWait:
    """Watches how far an autopilot is on its way into the air.

    Args:
        link: to it.
        log: has what it said.
        answer_within_s: how long it may take to send a first heartbeat, None for the usual time.
    """

    def __init__(self, link: Link, log: FlightLog, answer_within_s: float | None = None) -> None:
        self._link = link
        self._log = log
        self._answer_within_s = answer_within_s or _ANSWER_WITHIN_S
        self._connected_s = math.inf
        self._settled_s = math.inf

    def words(self, phase: AutonomyPhase | None) -> str:
        """Return the phase with what is waited for in it, "" where a pilot flies."""
        if phase is None:
            return ""
        why = ""
        if phase is AutonomyPhase.CONNECTING and self._link.connected:
            why = self._missing()
        elif phase in _ASKING:
            why = self._refusal()
        return f"{phase}: {why}" if why else str(phase)

    def check(self, phase: AutonomyPhase | None, now_s: float) -> None:
        """Refuse to wait for ever; called at `now_s` (seconds) until it flies.

        Raises:
            ConnectionFailedError: no autopilot sent a heartbeat for some time, its telemetry stays
                incomplete, or it does not take off.
        """
        missing = self._missing()
        pilot_can_fly = phase is None and self._link.state.position is not None
        if (phase is not None and not phase.takes_off) or pilot_can_fly:
            return
        status = self._link.status(now_s)
        if status.problem:
            raise ConnectionFailedError(status.problem)
        if self._link.connected:
            self._connected_s = min(self._connected_s, now_s)
        elif now_s > self._answer_within_s:
            waited = f"{self._answer_within_s:.0f} s ({status.line()})"
            raise ConnectionFailedError(
                f"no autopilot answered within {waited}: start it, have it send "
                "MAVLink to the address given by --connect, and try again"
            )
        if now_s - self._connected_s > _SETTLE_WITHIN_S and phase not in _ASKING:
            raise ConnectionFailedError(
                f"the autopilot's telemetry is incomplete after {_SETTLE_WITHIN_S:.0f} s: "
                f"{missing}; has it a GPS, and does nobody else set its message rates?"
            )
        self._check_taking_off(phase, now_s)

    def _check_taking_off(self, phase: AutonomyPhase | None, now_s: float) -> None:
        if phase in _ASKING:
            self._settled_s = min(self._settled_s, now_s)
        if now_s - self._settled_s > _AIRBORNE_WITHIN_S:
            said = self._refusal() or "it gives no reason"
            raise ConnectionFailedError(
                f"the vehicle is not in the air after {_AIRBORNE_WITHIN_S:.0f} s of {phase}: {said}"
            )

    def _missing(self) -> str:
        vehicle = self._link.state
        if vehicle.attitude is None:
            return "no attitude received yet"
        if vehicle.position is None:
            return "the estimator has no position yet"
        if self._link.altitude_msl_m is None:
            return "no height above mean sea level received yet"
        return ""

    def _refusal(self) -> str:
        """Return what the autopilot said in this phase, in its own words rather than a number's."""
        newest_s = self._log.controls[-1].time_s if self._log.controls else 0.0

        def is_of_now(event: Event) -> bool:
            return event.time_s > newest_s - _LATELY_S and event.source != "autonomy"

        events = takewhile(is_of_now, reversed(self._log.events))
        said = [event.text for event in events if event.source == "autopilot"]
        said = [text for text in said if " Hz" not in text]
        own = [text for text in said if not text.startswith("MAV_CMD_")]
        return next(iter(own + said), "")
