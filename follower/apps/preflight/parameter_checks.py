"""Checks of the autopilot's parameters against our settings.

What the real autopilots do with them was measured on PX4 1.18 and ArduCopter 4.6.3; see
docs/how-to/fly.md.
"""

from collections.abc import Callable
from typing import TypeAlias

from follower.apps.preflight.check import (
    CheckGroup,
    PreflightFinding,
    Snapshot,
    failed,
    passed,
    unknown,
    warned,
)
from follower_control.envelope.envelope import VERTICAL_BRAKING_M_S2

PARAMETERS = CheckGroup[Snapshot]("Parameters")
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
_IGNORES_RC_LOSS = 1 << 2
"""In OFFBOARD, of PX4's COM_RCL_EXCEPT; in GUIDED, of ArduCopter's FS_OPTIONS."""
_GUIDED_IGNORES_YAW, _NO_POSITION_HOLD, _NO_VELOCITY_HOLD = 1 << 2, 1 << 4, 1 << 5
_CENTI = 0.01

ParameterJudge: TypeAlias = Callable[[Snapshot, float], PreflightFinding]


def _parameter(
    autopilot: str, rule: str, *, needed: bool = True, **scales: float
) -> Callable[[ParameterJudge], ParameterJudge]:
    """Return a decorator that makes a function the judge of a parameter's value.

    Args:
        autopilot: "px4" or "ardupilot".
        rule: what the check wants.
        needed: nobody flies while it fails or is unknown.
        scales: names that the parameter has had; its value times the scale is in SI units and
            degrees: names and units change between versions.
    """

    def add(judge: ParameterJudge) -> ParameterJudge:
        names = tuple(scales)

        def check(s: Snapshot) -> PreflightFinding:
            for name, scale in scales.items():
                if name in s.parameters:
                    finding = judge(s, s.parameters[name] * scale)
                    own = "" if name == names[0] else f"{name} "
                    text = f"{own}{s.parameters[name]:g}: {finding.why}"
                    return PreflightFinding(finding.verdict, text, finding.todo)
            silent = "the autopilot has no such parameter, or does not report it"
            return unknown(f"{' or '.join(names)}: {silent}", "look it up by hand")

        PARAMETERS.check(names[0], rule, needed=needed, autopilots=(autopilot,), parameters=names)(
            check
        )
        return judge

    return add


def _limit(
    autopilot: str,
    key: str,
    unit: str,
    *,
    needed: bool = False,
    unlimited_by_zero: bool = False,
    **scales: float,
) -> None:
    """Add a check that a parameter allows as much as the envelope's setting `key`."""

    @_parameter(autopilot, f"at least envelope.{key}", needed=needed, **scales)
    def _at_least(s: Snapshot, value: float) -> PreflightFinding:
        wanted = getattr(s.settings.envelope, key)
        text = f"{value:g} {unit} allowed, {wanted:g} wanted"
        todo = f"set envelope.{key} to {value:g}, or raise it"
        if value == 0 and unlimited_by_zero:
            return passed("unlimited")
        if value >= wanted:
            return passed(text)
        if needed:
            return failed(f"{text}: fence and minimum distance would be overrun", todo)
        return warned(f"{text}: the autopilot cuts", todo)


@_parameter("px4", "from 10 of our intervals to 1 s; never above 5 s", COM_OF_LOSS_T=1.0)
def _loss_timeout(s: Snapshot, seconds: float) -> PreflightFinding:
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
            "set supervisor.alone_s below it, so that we release before the autopilot acts",
        )
    return passed(text)


@_parameter(
    "px4",
    "Position, Return, Land or Hold; never Stabilized, termination or disarming",
    COM_OBL_RC_ACT=1.0,
)
def _offboard_loss_action(_s: Snapshot, value: float) -> PreflightFinding:
    text = _OFFBOARD_LOSS.get(round(value), "an action that is not known here")
    if value in (0, 3, 4, 5):
        return passed(text)
    todo = "set it to 5 (Hold) or 3 (Return)"
    return warned(text, todo) if value == 1 else failed(text, todo)


@_parameter("px4", "not 4: the pilot's sticks count", COM_RC_IN_MODE=1.0)
def _rc_input(_s: Snapshot, value: float) -> PreflightFinding:
    if value == 4:
        return failed("sticks are disabled: nobody could take over", "set it to 0, 1, 2 or 3")
    return passed("sticks count")


@_parameter(
    "px4", "a lost remote control has an answer, and not that the motors stop", NAV_RCL_ACT=1.0
)
def _rc_loss_action(_s: Snapshot, value: float) -> PreflightFinding:
    if value in (5, 6):
        return failed("the motors stop when the remote control is lost", "set it to 2 (Return)")
    if value == 0:
        return warned("nothing happens when the remote control is lost", "set it to 2 (Return)")
    return passed("the autopilot takes over when the remote control is lost")


@_parameter(
    "px4",
    "a lost remote control counts in OFFBOARD, too (bit 2 clear)",
    needed=False,
    COM_RCL_EXCEPT=1.0,
)
def _rc_loss_counts(s: Snapshot, value: float) -> PreflightFinding:
    mode = "OFFBOARD" if s.link.autopilot == "px4" else "GUIDED"
    if round(value) & _IGNORES_RC_LOSS:
        return warned(f"a lost remote control is ignored in {mode}", "clear bit 2, which adds 4")
    return passed(f"a lost remote control counts in {mode}")


@_parameter("px4", "0, unless a ground station stays connected", needed=False, NAV_DLL_ACT=1.0)
def _ground_station_loss(_s: Snapshot, value: float) -> PreflightFinding:
    if value == 0:
        return passed("a lost ground station changes nothing")
    return warned(
        "acts when the ground station's heartbeat stops, and PX4 does not arm without one; our "
        "own heartbeat does not count",
        "keep a ground station connected during the flight (QGroundControl listens on UDP 14550), "
        "or set it to 0, as in a simulation",
    )


_limit("px4", "braking_m_s2", "m/s²", needed=True, MPC_ACC_HOR=1.0)
_limit("px4", "max_speed_m_s", "m/s", MPC_XY_VEL_MAX=1.0)
_limit("px4", "max_climb_m_s", "m/s", MPC_Z_VEL_MAX_UP=1.0)
_limit("px4", "max_descent_m_s", "m/s", MPC_Z_VEL_MAX_DN=1.0)
_limit("px4", "max_yaw_rate_deg_s", "deg/s", MC_YAWRATE_MAX=1.0)
_limit("px4", "max_yaw_rate_deg_s", "deg/s", MPC_MAN_Y_MAX=1.0)
_parameter(
    "ardupilot",
    "from 10 of our intervals to 1 s; never above 5 s (0.5 s stops within 4.4 m "
    "from 3 m/s, 3 s within 11.8 m)",
    GUID_TIMEOUT=1.0,
)(_loss_timeout)


@_parameter(
    "ardupilot",
    "velocity and drift are corrected (bits 4 and 5 clear), the pilot's yaw counts (bit 2 clear)",
    GUID_OPTIONS=1.0,
)
def _guided_options(_s: Snapshot, value: float) -> PreflightFinding:
    options = round(value)
    if options & _NO_VELOCITY_HOLD:
        return failed("GUIDED does not hold the velocity asked for", "clear bit 5, which adds 32")
    if options & _NO_POSITION_HOLD:
        return warned("GUIDED does not correct for drift", "clear bit 4, which adds 16")
    if options & _GUIDED_IGNORES_YAW:
        return warned("the pilot's yaw stick is ignored in GUIDED", "clear bit 2, which adds 4")
    return passed("velocities are flown as they were measured")


_parameter(
    "ardupilot", "0, unless a ground station stays connected", needed=False, FS_GCS_ENABLE=1.0
)(_ground_station_loss)


@_parameter("ardupilot", "a lost remote control has an answer", needed=False, FS_THR_ENABLE=1.0)
def _throttle_failsafe(_s: Snapshot, value: float) -> PreflightFinding:
    if value == 0:
        return warned("nothing happens when the remote control is lost", "set it to 1")
    return passed("the autopilot takes over when the remote control is lost")


_parameter(
    "ardupilot",
    "a lost remote control counts in GUIDED, too (bit 2 clear)",
    needed=False,
    FS_OPTIONS=1.0,
)(_rc_loss_counts)


@_parameter(
    "ardupilot", "not the vehicle's own system id", needed=False, SYSID_MYGCS=1.0, MAV_GCS_SYSID=1.0
)
def _ground_station_id(s: Snapshot, value: float) -> PreflightFinding:
    if value == s.link.vehicle_id:
        return failed(
            "is the vehicle's own system id: our heartbeat would hide the loss of the ground "
            "station",
            "set it to the ground station's, usually 255",
        )
    return passed("is not ours")


_limit("ardupilot", "braking_m_s2", "m/s²", needed=True, WPNAV_ACCEL=_CENTI, WP_ACC=1.0)


@_parameter(
    "ardupilot",
    f"at least {VERTICAL_BRAKING_M_S2:g} m/s²",
    needed=False,
    WPNAV_ACCEL_Z=_CENTI,
    WP_ACC_Z=1.0,
)
def _vertical_braking(_s: Snapshot, value: float) -> PreflightFinding:
    text = f"{value:g} m/s² allowed, {VERTICAL_BRAKING_M_S2:g} counted on"
    if value >= VERTICAL_BRAKING_M_S2:
        return passed(text)
    return warned(f"{text}: ceiling and lowest height would be overrun", "raise it")


_limit("ardupilot", "max_speed_m_s", "m/s", WPNAV_SPEED=_CENTI, WP_SPD=1.0)
_limit("ardupilot", "max_yaw_rate_deg_s", "deg/s", ATC_SLEW_YAW=_CENTI)
_limit(
    "ardupilot",
    "max_yaw_acceleration_deg_s2",
    "deg/s²",
    unlimited_by_zero=True,
    ATC_ACCEL_Y_MAX=_CENTI,
    ATC_ACC_Y_MAX=1.0,
)
