"""The table of checks: everything else, the help and the page's table too, is derived from it."""

from __future__ import annotations

from collections.abc import Mapping

from follower.preflight import (
    camera_checks,
    computer_checks,
    health_checks,
    link_checks,
    parameter_checks,
)
from follower.preflight.check import Check
from follower.preflight.parameter_checks import ParameterJudge, parameter_judge

LINK, HEALTH, PARAMETERS = "Link", "Autopilot", "Parameters"
CAMERA, COMPUTER = "Camera", "Computer"
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


CHECKS = (
    Check(
        "vehicle",
        LINK,
        "one vehicle is heard, and its heartbeat is younger than 3 s",
        link_checks.vehicle,
    ),
    Check("type", LINK, "it is a multicopter or helicopter", link_checks.vehicle_type),
    Check(
        "firmware",
        LINK,
        "PX4 1.14 to 1.18 or ArduCopter 4.2 to 4.6",
        link_checks.firmware,
        needed=False,
    ),
    Check(
        "attitude-rate",
        LINK,
        "ATTITUDE at 40 % of the rate asked for; never below 10 Hz",
        link_checks.attitude_rate,
    ),
    Check(
        "position-rate",
        LINK,
        "LOCAL_POSITION_NED at 40 % of the rate asked for; never below 5 Hz",
        link_checks.position_rate,
    ),
    Check(
        "round-trip",
        LINK,
        "TIMESYNC is answered within 0.2 s; never later than 0.5 s",
        link_checks.round_trip,
    ),
    Check(
        "clocks",
        LINK,
        "the autopilot's times are known on our clock to 50 ms; never worse than 150 ms",
        link_checks.clocks,
    ),
    Check(
        "attitude-age",
        LINK,
        "attitudes are at most 150 ms old; never older than "
        "supervisor.telemetry_timeout_s; their numbers change",
        link_checks.attitude_age,
    ),
    Check(
        "packet-loss",
        LINK,
        "at most 2 % of the packets are lost; never more than 10 %",
        link_checks.packet_loss,
    ),
    Check(
        "sensors",
        HEALTH,
        "SYS_STATUS calls gyroscope, accelerometer, compass, barometer, GPS and attitude healthy",
        health_checks.sensors,
    ),
    Check(
        "remote-control",
        HEALTH,
        "SYS_STATUS has a healthy RC receiver",
        health_checks.remote_control,
        needed=False,
    ),
    Check(
        "battery",
        HEALTH,
        "above health.battery_to_start by 15 %; never below it",
        health_checks.battery,
    ),
    Check(
        "gps",
        HEALTH,
        "a fix of health.gps_fix, 8 satellites, HDOP 2.5; with health.gps_fix null an "
        "estimator that has a position without it",
        health_checks.gps,
    ),
    Check(
        "estimator",
        HEALTH,
        "attitude, velocity and position are estimated, no test ratio above 0.8; never above 1",
        health_checks.estimator,
    ),
    Check("position", HEALTH, "a local position that is fresh", health_checks.position),
    Check(
        "mode",
        HEALTH,
        "not OFFBOARD or GUIDED yet: following begins when the pilot says so",
        health_checks.mode,
    ),
    Check(
        "landed-state",
        HEALTH,
        "EXTENDED_SYS_STATE says whether it stands on the ground",
        health_checks.landed_state,
        needed=False,
    ),
    Check(
        "consent",
        HEALTH,
        "with consent.kind rc the switch's channel is heard, and the switch is off",
        health_checks.consent,
    ),
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
    Check("camera", CAMERA, "frames come", camera_checks.camera),
    Check(
        "frame-rate",
        CAMERA,
        "15 Hz with jitter below half an interval; never below 5 Hz, no gap longer "
        "than supervisor.frame_timeout_s",
        camera_checks.frame_rate,
    ),
    Check(
        "frame-age",
        CAMERA,
        "a frame is at most 150 ms old when it is taken; never older than "
        "supervisor.frame_timeout_s",
        camera_checks.frame_age,
    ),
    Check(
        "picture",
        CAMERA,
        "the picture is not of one colour and does not stand still",
        camera_checks.picture,
    ),
    Check(
        "frame-size",
        CAMERA,
        "frames have the size camera.frame_size, if that is set",
        camera_checks.frame_size,
    ),
    Check(
        "lens",
        CAMERA,
        "a field of view of 15 to 130 deg or a focal length is set; the distortion "
        "does not fold the image",
        camera_checks.lens,
    ),
    Check(
        "mount", CAMERA, "the camera does not look into the sky", camera_checks.mount, needed=False
    ),
    Check(
        "models",
        CAMERA,
        "the networks that the settings name are there, with the right SHA-256",
        camera_checks.models,
    ),
    Check(
        "disk", COMPUTER, "4 GB free for the recording; never below 0.5 GB", computer_checks.disk
    ),
    Check(
        "temperature",
        COMPUTER,
        "below 75 °C; never above 85 °C",
        computer_checks.temperature,
        needed=False,
    ),
    Check(
        "throttling",
        COMPUTER,
        "not slowed down, no voltage too low (Raspberry Pi)",
        computer_checks.throttling,
        needed=False,
    ),
    Check(
        "load",
        COMPUTER,
        "less than 0.7 running processes a core",
        computer_checks.load,
        needed=False,
    ),
)
