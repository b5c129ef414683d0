"""Checks of the autopilot's parameters against our settings.

What the real autopilots do with them was measured on PX4 1.18 and ArduCopter 4.6.3; see
docs/fly.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from follower.preflight.finding import Finding, failed, passed, unknown, warned
from follower.preflight.snapshot import Snapshot

_MISSED_STEPS = 10
"""A stream may pause for so many of its intervals without the autopilot acting."""
_PATIENT_S, _TOO_PATIENT_S = 1.0, 5.0
_OFFBOARD_LOSS = {
    0: "Position mode, or its next best without a remote control",
    1: "Altitude mode, in which it drifts",
    2: "Stabilized mode, in which it falls without a hand on the throttle",
    3: "Return",
    4: "Land",
    5: "Hold",
    6: "termination: the motors stop",
    7: "disarming: the motors stop",
}
_IGNORES_OFFBOARD = 1 << 2
_GUIDED_IGNORES_YAW, _NO_POSITION_HOLD, _NO_VELOCITY_HOLD = 1 << 2, 1 << 4, 1 << 5
_CONTINUE_IN_GUIDED = 1 << 2

ParameterJudge = Callable[[Snapshot, float], Finding]


def parameter_judge(
    scales: Mapping[str, float], judge: ParameterJudge
) -> Callable[[Snapshot], Finding]:
    """Return a judge of the first of these parameters that the autopilot has, times its scale."""

    def check(s: Snapshot) -> Finding:
        for name, scale in scales.items():
            if name in s.parameters:
                finding = judge(s, s.parameters[name] * scale)
                own = "" if name == next(iter(scales)) else f"{name} "
                text = f"{own}{s.parameters[name]:g}: {finding.why}"
                return Finding(finding.verdict, text, finding.todo)
        silent = "the autopilot has no such parameter, or does not tell it"
        return unknown(f"{' or '.join(scales)}: {silent}", "look it up by hand")

    return check


def loss_timeout(s: Snapshot, seconds: float) -> Finding:
    """How long the autopilot flies the last velocity after our stream has ended."""
    interval_s = 1.0 / s.settings.control_rate_hz
    alone_s = s.settings.supervisor.alone_s
    if seconds < max(_MISSED_STEPS * interval_s, 0.2):
        return failed(
            f"acts after a pause of {seconds:g} s already, our stream comes every "
            f"{1e3 * interval_s:.0f} ms",
            "set it to 0.5 to 1 s",
        )
    text = f"flies our last velocity on for {seconds:g} s after the stream has ended"
    if seconds > _TOO_PATIENT_S:
        return failed(text, "set it to 0.5 to 1 s")
    if seconds > _PATIENT_S:
        return warned(text, "set it to 0.5 to 1 s")
    if alone_s > seconds:
        return warned(
            f"{text}; supervisor.alone_s ({alone_s:g} s) is longer",
            "set supervisor.alone_s below it, so that we let go before the autopilot acts",
        )
    return passed(text)


def offboard_loss_action(_s: Snapshot, value: float) -> Finding:
    """What PX4 does when the stream ends."""
    text = _OFFBOARD_LOSS.get(round(value), "an action that is not known here")
    if value in (0, 3, 4, 5):
        return passed(text)
    todo = "set it to 5 (Hold) or 3 (Return)"
    return warned(text, todo) if value == 1 else failed(text, todo)


def rc_input(_s: Snapshot, value: float) -> Finding:
    """Whether the pilot's sticks count."""
    if value == 4:
        return failed("sticks are disabled: nobody could take over", "set it to 0, 1, 2 or 3")
    return passed("sticks count")


def rc_loss_action(_s: Snapshot, value: float) -> Finding:
    """What PX4 does when the remote control is lost."""
    if value in (5, 6):
        return failed("the motors stop when the remote control is lost", "set it to 2 (Return)")
    if value == 0:
        return warned("nothing happens when the remote control is lost", "set it to 2 (Return)")
    return passed("the autopilot takes over when the remote control is lost")


def data_link_loss(_s: Snapshot, value: float) -> Finding:
    """Whether PX4 wants a ground station, to arm and all the time."""
    if value == 0:
        return passed("a lost ground station changes nothing")
    return warned(
        "does not arm without a ground station, and acts when its heartbeat stops; our own "
        "heartbeat does not count",
        "keep a ground station connected during the flight (QGroundControl listens on UDP 14550), "
        "or set it to 0, as in a simulation",
    )


def rc_loss_exceptions(_s: Snapshot, value: float) -> Finding:
    """Whether a lost remote control counts in OFFBOARD."""
    if round(value) & _IGNORES_OFFBOARD:
        return warned("a lost remote control is ignored in OFFBOARD", "clear bit 2, which adds 4")
    return passed("a lost remote control counts in OFFBOARD")


def guided_options(_s: Snapshot, value: float) -> Finding:
    """Whether GUIDED flies velocities as it does by default."""
    options = round(value)
    if options & _NO_VELOCITY_HOLD:
        return failed("GUIDED does not hold the velocity asked for", "clear bit 5, which adds 32")
    if options & _NO_POSITION_HOLD:
        return warned("GUIDED does not correct for drift", "clear bit 4, which adds 16")
    if options & _GUIDED_IGNORES_YAW:
        return warned("the pilot's yaw stick is ignored in GUIDED", "clear bit 2, which adds 4")
    return passed("velocities are flown as they were measured")


def gcs_failsafe(_s: Snapshot, value: float) -> Finding:
    """Whether a ground station has to be connected all the time."""
    if value == 0:
        return passed("a lost ground station changes nothing")
    return warned(
        "goes home or lands when the ground station's heartbeat stops, although we stream; our "
        "own heartbeat does not count",
        "keep a ground station connected during the flight, or set it to 0",
    )


def throttle_failsafe(_s: Snapshot, value: float) -> Finding:
    """What ArduCopter does when the remote control is lost."""
    if value == 0:
        return warned("nothing happens when the remote control is lost", "set it to 1")
    return passed("the autopilot takes over when the remote control is lost")


def failsafe_options(_s: Snapshot, value: float) -> Finding:
    """Whether a lost remote control counts in GUIDED."""
    if round(value) & _CONTINUE_IN_GUIDED:
        return warned("a lost remote control is ignored in GUIDED", "clear bit 2, which adds 4")
    return passed("a lost remote control counts in GUIDED")


def ground_station_id(s: Snapshot, value: float) -> Finding:
    """Our heartbeat is not taken for the ground station's."""
    if value == s.link.vehicle_id:
        return failed(
            "is the vehicle's own system id: our heartbeat would hide the loss of the ground "
            "station",
            "set it to the ground station's, usually 255",
        )
    return passed("is not ours")


def top_speed(s: Snapshot, value: float) -> Finding:
    """The autopilot allows our top speed."""
    return _at_least(value, s.settings.envelope.max_speed_m_s, "m/s", "envelope.max_speed_m_s")


def climb(s: Snapshot, value: float) -> Finding:
    """The autopilot allows our fastest climb."""
    return _at_least(value, s.settings.envelope.max_climb_m_s, "m/s", "envelope.max_climb_m_s")


def descent(s: Snapshot, value: float) -> Finding:
    """The autopilot allows our fastest descent."""
    return _at_least(value, s.settings.envelope.max_descent_m_s, "m/s", "envelope.max_descent_m_s")


def yaw_rate(s: Snapshot, value: float) -> Finding:
    """The autopilot allows our fastest turn."""
    wanted = s.settings.envelope.max_yaw_rate_deg_s
    return _at_least(value, wanted, "deg/s", "envelope.max_yaw_rate_deg_s")


def braking(s: Snapshot, value: float) -> Finding:
    """The autopilot brakes as hard as the envelope counts on."""
    wanted = s.settings.envelope.braking_m_s2
    if value >= wanted:
        return passed(f"{value:g} m/s², {wanted:g} counted on")
    return failed(
        f"brakes with {value:g} m/s² only, the envelope counts on {wanted:g}: fence and minimum "
        "distance would be overrun",
        "set envelope.braking_m_s2 to it, or raise the parameter",
    )


def _at_least(value: float, wanted: float, unit: str, setting: str) -> Finding:
    text = f"{value:g} {unit} allowed, {wanted:g} wanted"
    if value >= wanted:
        return passed(text)
    return warned(f"{text}: the autopilot cuts", f"set {setting} to {value:g}, or raise it")
