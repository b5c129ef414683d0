"""The table of checks: everything else, the help and the page's table too, is derived from it."""

from __future__ import annotations

from follower.preflight import camera_checks, computer_checks, health_checks, link_checks
from follower.preflight.check import Check
from follower.preflight.parameter_table import PARAMETER_CHECKS

LINK, HEALTH = "Link", "Autopilot"
CAMERA, COMPUTER = "Camera", "Computer"

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
    Check(
        "sticks",
        HEALTH,
        "RC_CHANNELS come, if the settings have sticks nudge or take over",
        health_checks.sticks,
    ),
    *PARAMETER_CHECKS,
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
        "circling",
        CAMERA,
        "with servo.mode side or orbit the distance comes from the ground (servo.range_from): a "
        "size changes with the side that is seen",
        camera_checks.circling,
        needed=False,
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
