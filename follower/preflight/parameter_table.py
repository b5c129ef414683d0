"""The checks of the autopilot's parameters, each with the rule that it wants kept."""

from __future__ import annotations

from collections.abc import Mapping

from follower.preflight import parameter_checks
from follower.preflight.check import Check
from follower.preflight.parameter_checks import ParameterJudge, parameter_judge

PARAMETERS = "Parameters"
_CENTI = 0.01


def _px4(
    scales: Mapping[str, float], rule: str, judge: ParameterJudge, needed: bool = True
) -> Check:
    return _parameter("px4", scales, rule, judge, needed)


def _ardupilot(
    scales: Mapping[str, float], rule: str, judge: ParameterJudge, needed: bool = True
) -> Check:
    return _parameter("ardupilot", scales, rule, judge, needed)


def _parameter(
    autopilot: str, scales: Mapping[str, float], rule: str, judge: ParameterJudge, needed: bool
) -> Check:
    """Return a check of the first of these parameters that the autopilot has.

    Their values times their scales are in SI units and degrees: names and units change between
    versions.
    """
    names = tuple(scales)
    return Check(
        names[0], PARAMETERS, rule, parameter_judge(scales, judge), needed, (autopilot,), names
    )


PARAMETER_CHECKS = (
    _px4(
        {"COM_OF_LOSS_T": 1.0},
        "from 10 of our intervals to 1 s; never above 5 s",
        parameter_checks.loss_timeout,
    ),
    _px4(
        {"COM_OBL_RC_ACT": 1.0},
        "Position, Return, Land or Hold; never Stabilized, termination or disarming",
        parameter_checks.offboard_loss_action,
    ),
    _px4({"COM_RC_IN_MODE": 1.0}, "not 4: the pilot's sticks count", parameter_checks.rc_input),
    _px4(
        {"NAV_RCL_ACT": 1.0},
        "a lost remote control has an answer, and not that the motors stop",
        parameter_checks.rc_loss_action,
    ),
    _px4(
        {"COM_RCL_EXCEPT": 1.0},
        "a lost remote control counts in OFFBOARD, too (bit 2 clear)",
        parameter_checks.rc_loss_exceptions,
        needed=False,
    ),
    _px4(
        {"NAV_DLL_ACT": 1.0},
        "0, unless a ground station stays connected",
        parameter_checks.data_link_loss,
        needed=False,
    ),
    _px4({"MPC_ACC_HOR": 1.0}, "at least envelope.braking_m_s2", parameter_checks.braking),
    _px4(
        {"MPC_XY_VEL_MAX": 1.0},
        "at least envelope.max_speed_m_s",
        parameter_checks.top_speed,
        needed=False,
    ),
    _px4(
        {"MPC_Z_VEL_MAX_UP": 1.0},
        "at least envelope.max_climb_m_s",
        parameter_checks.climb,
        needed=False,
    ),
    _px4(
        {"MPC_Z_VEL_MAX_DN": 1.0},
        "at least envelope.max_descent_m_s",
        parameter_checks.descent,
        needed=False,
    ),
    _px4(
        {"MC_YAWRATE_MAX": 1.0},
        "at least envelope.max_yaw_rate_deg_s",
        parameter_checks.yaw_rate,
        needed=False,
    ),
    _px4(
        {"MPC_MAN_Y_MAX": 1.0},
        "at least envelope.max_yaw_rate_deg_s, so that the pilot can turn as fast as we do",
        parameter_checks.yaw_rate,
        needed=False,
    ),
    _ardupilot(
        {"GUID_TIMEOUT": 1.0},
        "from 10 of our intervals to 1 s; never above 5 s (0.5 s stops within 4.4 m "
        "from 3 m/s, 3 s within 11.8 m)",
        parameter_checks.loss_timeout,
    ),
    _ardupilot(
        {"GUID_OPTIONS": 1.0},
        "velocity and drift are corrected (bits 4 and 5 clear), the pilot's yaw "
        "counts (bit 2 clear)",
        parameter_checks.guided_options,
    ),
    _ardupilot(
        {"FS_GCS_ENABLE": 1.0},
        "0, unless a ground station stays connected",
        parameter_checks.gcs_failsafe,
        needed=False,
    ),
    _ardupilot(
        {"FS_THR_ENABLE": 1.0},
        "a lost remote control has an answer",
        parameter_checks.throttle_failsafe,
        needed=False,
    ),
    _ardupilot(
        {"FS_OPTIONS": 1.0},
        "a lost remote control counts in GUIDED, too (bit 2 clear)",
        parameter_checks.failsafe_options,
        needed=False,
    ),
    _ardupilot(
        {"SYSID_MYGCS": 1.0, "MAV_GCS_SYSID": 1.0},
        "not the vehicle's own system id",
        parameter_checks.ground_station_id,
        needed=False,
    ),
    _ardupilot(
        {"WPNAV_ACCEL": _CENTI, "WP_ACC": 1.0},
        "at least envelope.braking_m_s2 (cm/s² in the autopilot)",
        parameter_checks.braking,
    ),
    _ardupilot(
        {"WPNAV_SPEED": _CENTI, "WP_SPD": 1.0},
        "at least envelope.max_speed_m_s (cm/s in the autopilot)",
        parameter_checks.top_speed,
        needed=False,
    ),
    _ardupilot(
        {"ATC_SLEW_YAW": _CENTI},
        "at least envelope.max_yaw_rate_deg_s (hundredths of deg/s in the autopilot)",
        parameter_checks.yaw_rate,
        needed=False,
    ),
)
