"""Every check of the preflight table: passing, and failing for its reason."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from preflight_checks import CHECK_LIST
from rich.console import Console

from follower.apps.preflight.check import (
    CameraReading,
    ComputerReading,
    PreflightResult,
    PreflightVerdict,
    Snapshot,
)
from follower.apps.preflight.checklist import (
    CHECKS,
    check_names,
    parameters_for,
    print_checklist,
    run_checks,
    to_json,
)
from follower.links.request_scheduler import MessageRate
from follower.links.status import LinkStatus
from follower.links.vehicle_health import (
    EstimatorHealth,
    GpsHealth,
    SensorHealth,
    VehicleHealth,
)
from follower.settings.settings import Settings
from follower_control.common.strict_config import SettingsError
from follower_control.vehicle.state import LocalPosition, RcChannels, VehicleState
from follower_sim.autopilot.parameters import ARDUCOPTER_PARAMETERS, PX4_PARAMETERS

PASS, WARN, FAIL, UNKNOWN = (
    PreflightVerdict.PASS,
    PreflightVerdict.WARN,
    PreflightVerdict.FAIL,
    PreflightVerdict.UNKNOWN,
)
NOW_S = 100.0
ALL_ESTIMATES = 0x33F
GYRO, GPS, RC, PREARM = 1, 32, 65536, 268435456
SENSORS = GYRO | GPS | RC | PREARM

Change = Callable[[Snapshot], Snapshot]


def settings(**camera: Any) -> Settings:
    return Settings.model_validate({"camera": {"fov_deg": 70.0, **camera}})


def indoors() -> Settings:
    return Settings.model_validate({"camera": {"fov_deg": 70.0}, "health": {"gps_fix": None}})


def recorder(free_bytes: float, **changes: Any) -> Change:
    """Set what is recorded, and how much room there is for it."""
    asked = {"camera": {"fov_deg": 70.0}, "recorder": changes}
    room = computer(free_bytes=int(free_bytes))
    return lambda s: replace(room(s), settings=Settings.model_validate(asked))


def with_gimbal() -> Settings:
    return Settings.model_validate({"camera": {"fov_deg": 70.0}, "gimbal": {"enabled": True}})


def rc_switch(pulse_us: int | None, **changes: Any) -> Change:
    """Ask for a switch's consent, and have it stand somewhere."""
    asked = {"camera": {"fov_deg": 70.0}, "consent": {"kind": "rc", "rc_channel": 5, **changes}}
    switch = () if pulse_us is None else (pulse_us,)
    rc = RcChannels((1500,) * 4 + switch, NOW_S)
    return lambda s: replace(
        s, settings=Settings.model_validate(asked), vehicle=replace(s.vehicle, rc=rc)
    )


def servo(**changes: Any) -> Change:
    """Set how it follows."""
    asked = {"camera": {"fov_deg": 70.0}, "servo": changes}
    return lambda s: replace(s, settings=Settings.model_validate(asked))


def sticks(heard_s: float | None, **changes: Any) -> Change:
    """Set what sticks do, and when the last four of them came."""
    asked = {"camera": {"fov_deg": 70.0}, "sticks": changes}
    rc = None if heard_s is None else RcChannels((1500,) * 4, heard_s)
    return lambda s: replace(
        s, settings=Settings.model_validate(asked), vehicle=replace(s.vehicle, rc=rc)
    )


def healthy(flavour: str) -> Snapshot:
    """A vehicle, a camera and a computer with which all is well."""
    parameters = PX4_PARAMETERS if flavour == "px4" else ARDUCOPTER_PARAMETERS | {"GUID_TIMEOUT": 1}
    return Snapshot(
        now_s=NOW_S,
        settings=settings(),
        link=LinkStatus(
            "pymavlink",
            1,
            flavour,
            round_trip_s=0.03,
            clock_error_s=0.006,
            rates=(MessageRate("ATTITUDE", 100, 98), MessageRate("LOCAL_POSITION_NED", 30, 30)),
            of_vehicle=1000,
        ),
        vehicle=VehicleState(
            position=LocalPosition(0, 0, 0, 0, 0, 0, NOW_S - 0.05),
            mode="LOITER",
            heartbeat_s=NOW_S - 0.5,
            rc=RcChannels((1500,) * 4, NOW_S),
            landed=True,
        ),
        health=VehicleHealth(
            2,
            (1, 18, 0) if flavour == "px4" else (4, 6, 3),
            SensorHealth(SENSORS, SENSORS, 0.9, NOW_S),
            GpsHealth(3, 12, 0.8, NOW_S),
            EstimatorHealth(ALL_ESTIMATES, 0.1, 0.2, 0.1, 0.1, False, NOW_S),
        ),
        attitude_age_s=0.03,
        parameters=parameters,
        camera=CameraReading("0", "", (640, 480), 90, 0.033, 0.05, 0.004, 0.02, 40.0),
        computer=ComputerReading(int(60e9), "runs", 55.0, 0, 0.3),
    )


def link(**changes: Any) -> Change:
    return lambda s: replace(s, link=replace(s.link, **changes))


def rates(attitude_hz: float, position_hz: float = 30) -> Change:
    return link(
        rates=(
            MessageRate("ATTITUDE", 100, attitude_hz),
            MessageRate("LOCAL_POSITION_NED", 30, position_hz),
        )
    )


def vehicle(**changes: Any) -> Change:
    return lambda s: replace(s, vehicle=replace(s.vehicle, **changes))


def fenced(corners_m: list[list[float]], place_m: tuple[float, float]) -> Change:
    """Set a fence about home, and where the vehicle is."""
    asked = {"camera": {"fov_deg": 70.0}, "envelope": {"fence_m": corners_m}}
    position = LocalPosition(*place_m, 0, 0, 0, 0, NOW_S)
    return lambda s: replace(
        s,
        settings=Settings.model_validate(asked),
        vehicle=replace(s.vehicle, position=position),
    )


def health(**changes: Any) -> Change:
    return lambda s: replace(s, health=replace(s.health, **changes))


def sensors(**changes: Any) -> Change:
    return lambda s: health(sensors=replace(s.health.sensors, **changes))(s)


def estimator(**changes: Any) -> Change:
    return lambda s: health(estimator=replace(s.health.estimator, **changes))(s)


def camera(**changes: Any) -> Change:
    return lambda s: replace(s, camera=replace(s.camera, **changes))


def lens(**changes: Any) -> Change:
    return lambda s: replace(s, settings=settings(**changes))


def computer(**changes: Any) -> Change:
    return lambda s: replace(s, computer=replace(s.computer, **changes))


def parameter(name: str, value: float) -> Change:
    return lambda s: replace(s, parameters={**s.parameters, name: value})


def without(name: str) -> Change:
    return lambda s: replace(
        s, parameters={key: value for key, value in s.parameters.items() if key != name}
    )


def result(snapshot: Snapshot, name: str) -> PreflightResult:
    return next(one for one in run_checks(snapshot) if one.check.name == name)


BOTH = [
    ("vehicle", link(vehicle_id=None), FAIL, "no heartbeat"),
    (
        "vehicle",
        link(problem="several vehicles send heartbeats: 1 (px4), 2 (px4)"),
        FAIL,
        "several",
    ),
    ("vehicle", vehicle(heartbeat_s=NOW_S - 7), FAIL, "no heartbeat for 7 s"),
    ("type", health(vehicle_type=1), FAIL, "MAV_TYPE_FIXED_WING"),
    ("type", health(vehicle_type=None), UNKNOWN, "not said"),
    ("firmware", health(firmware=(1, 9, 0)), WARN, "older"),
    ("firmware", health(firmware=(9, 0, 0)), WARN, "newer"),
    ("firmware", health(firmware=None), UNKNOWN, "version"),
    ("attitude-rate", rates(50), PASS, "50 Hz"),
    ("attitude-rate", rates(20), WARN, "20 Hz"),
    ("attitude-rate", rates(4), FAIL, "4 Hz"),
    ("attitude-rate", rates(0), FAIL, "does not come at all"),
    ("position-rate", rates(100, 3), FAIL, "3 Hz"),
    ("round-trip", link(round_trip_s=0.3), WARN, "300 ms"),
    ("round-trip", link(round_trip_s=0.8), FAIL, "800 ms"),
    ("round-trip", link(round_trip_s=None), UNKNOWN, "not answered"),
    ("clocks", link(clock_error_s=0.1), WARN, "100 ms"),
    ("clocks", link(clock_error_s=0.2), FAIL, "200 ms"),
    ("clocks", link(clock_restarts=2), WARN, "jumped"),
    ("attitude-age", lambda s: replace(s, attitude_age_s=0.3), WARN, "300 ms"),
    ("attitude-age", lambda s: replace(s, attitude_age_s=0.7), FAIL, "700 ms"),
    ("attitude-age", lambda s: replace(s, attitude_age_s=math.inf), FAIL, "no attitude"),
    (
        "attitude-age",
        lambda s: replace(s, attitude_repeats=True),
        FAIL,
        "repeats",
    ),
    ("packet-loss", link(lost=60), WARN, "5.7%"),
    ("packet-loss", link(lost=500), FAIL, "33.3%"),
    ("sensors", sensors(healthy=SENSORS & ~GYRO), FAIL, "gyroscope"),
    ("sensors", sensors(healthy=SENSORS & ~PREARM), WARN, "pre-arm"),
    ("sensors", health(sensors=None), UNKNOWN, "SYS_STATUS"),
    ("remote-control", sensors(healthy=SENSORS & ~RC), WARN, "receives nothing"),
    ("remote-control", sensors(enabled=SENSORS & ~RC), WARN, "no RC"),
    ("battery", sensors(battery_share=0.4), WARN, "40%"),
    ("battery", sensors(battery_share=0.1), FAIL, "10%"),
    ("battery", sensors(battery_share=None), WARN, "does not know"),
    ("gps", health(gps=GpsHealth(3, 5, 0.8, NOW_S)), WARN, "5 satellites"),
    ("gps", health(gps=GpsHealth(1, 0, None, NOW_S)), FAIL, "no position yet"),
    (
        "gps",
        lambda s: replace(s, settings=indoors(), health=health(gps=None)(s).health),
        WARN,
        "but",
    ),
    ("gps", health(gps=None, estimator=None), FAIL, "does not come"),
    ("estimator", estimator(flags=ALL_ESTIMATES & ~2), FAIL, "horizontal velocity"),
    ("estimator", estimator(flags=0xA7), FAIL, "no position"),
    ("estimator", estimator(compass_ratio=0.9), WARN, "compass"),
    ("estimator", estimator(velocity_ratio=1.2), FAIL, "velocity"),
    ("estimator", estimator(gps_glitch=True), FAIL, "jump"),
    ("estimator", estimator(time_s=NOW_S - 20), UNKNOWN, "does not come"),
    ("position", vehicle(position=None), FAIL, "does not come"),
    ("position", vehicle(position=LocalPosition(0, 0, 0, 0, 0, 0, 1.0)), FAIL, "99.0 s old"),
    ("position", fenced([[0, 0], [0, 9], [9, 9], [9, 0]], (4, 4)), PASS, "above home"),
    ("position", fenced([[0, 0], [0, 9], [9, 9], [9, 0]], (-4, 4)), FAIL, "-4 m north and 4 m"),
    ("mode", vehicle(obeys_setpoints=True), WARN, "disarmed"),
    ("mode", vehicle(obeys_setpoints=True, armed=True), FAIL, "armed"),
    ("landed-state", vehicle(landed=None), WARN, "does not say"),
    ("consent", rc_switch(None), FAIL, "not heard"),
    ("consent", rc_switch(1900), WARN, "1900"),
    ("consent", rc_switch(1100), PASS, "1100"),
    ("consent", rc_switch(1100, rc_reversed=True), WARN, "1100"),
    ("sticks", sticks(None), WARN, "will not take over"),
    ("sticks", sticks(None, nudge=True), FAIL, "sticks.nudge"),
    ("sticks", sticks(NOW_S - 5.0), WARN, "do not come"),
    ("sticks", sticks(NOW_S), PASS, "heard"),
    ("sticks", sticks(NOW_S, yaw_channel=5), WARN, "do not come"),
    ("sticks", sticks(None, takeover=None), PASS, "no effect"),
    ("camera", camera(frames=0, problem="the stream ended"), FAIL, "the stream ended"),
    ("frame-rate", camera(interval_s=0.1), WARN, "10 Hz"),
    ("frame-rate", camera(interval_s=0.5), FAIL, "2 Hz"),
    ("frame-rate", camera(worst_interval_s=1.0), FAIL, "1000 ms"),
    ("frame-rate", camera(jitter_s=0.03), WARN, "jitter 30 ms"),
    ("frame-rate", camera(interval_s=math.nan), UNKNOWN, "too few"),
    ("frame-age", camera(age_s=0.3), WARN, "300 ms"),
    ("frame-age", camera(age_s=0.8), FAIL, "800 ms"),
    ("picture", camera(contrast=0.5), FAIL, "black"),
    ("picture", camera(repeats=80), WARN, "same"),
    ("frame-size", lens(frame_size=(640, 480)), PASS, "640x480"),
    ("frame-size", lens(frame_size=(1280, 720)), FAIL, "640x480"),
    ("frame-size", lens(distortion=(0.01, 0, 0, 0, 0)), WARN, "not set"),
    ("lens", lambda s: replace(s, lens_given=False), FAIL, "neither"),
    ("lens", lens(fov_deg=5), FAIL, "5 deg"),
    ("lens", lens(focal_px=100.0), FAIL, "145 deg"),
    ("lens", lens(distortion=(-0.9, 0, 0, 0, 0)), FAIL, "folds"),
    ("lens", lens(distortion=(-0.28, 0.07, 0, 0, 0)), PASS, "70 deg"),
    ("mount", lens(pitch_deg=-25), PASS, "25 deg down"),
    ("mount", lens(pitch_deg=60), WARN, "sky"),
    ("mount", lens(pitch_deg=-20, roll_deg=180), PASS, "rolled"),
    ("mount", lens(pitch_deg=-20, yaw_deg=180), FAIL, "the camera away from it"),
    ("mount", lens(pitch_deg=-20, yaw_deg=-45), FAIL, "the camera away from it"),
    ("mount", lens(pitch_deg=-120), FAIL, "the camera away from it"),
    ("mount", lambda s: replace(s, settings=with_gimbal()), WARN, "gimbal"),
    ("circling", servo(mode="orbit"), WARN, "comes too near"),
    ("circling", servo(mode="side", range_from="ground"), PASS, "from the ground"),
    ("circling", servo(mode="chase"), PASS, "does not go round"),
    ("models", lambda s: replace(s, models={"a.onnx": "missing"}), FAIL, "a.onnx is missing"),
    ("models", lambda s: replace(s, models={"a.onnx": "good"}), PASS, "a.onnx"),
    ("disk", computer(free_bytes=int(3e9)), PASS, "3.0 GB free in runs, 2.4 GB needed for 30 min"),
    ("disk", computer(free_bytes=int(1e9)), WARN, "1.0 GB"),
    ("disk", recorder(20e9, video="lossless"), WARN, "33.9 GB needed"),
    ("disk", recorder(20e9, video="lossless", flight_min=10), PASS, "11.4 GB needed for 10 min"),
    ("disk", recorder(0.5e9, video="none"), PASS, "0.2 GB needed"),
    ("disk", computer(free_bytes=int(1e8)), FAIL, "0.1 GB"),
    ("disk", computer(free_bytes=None), UNKNOWN, "runs"),
    ("disk", computer(writable=False), FAIL, "runs cannot be written"),
    ("temperature", computer(temperature_c=80), WARN, "80"),
    ("temperature", computer(temperature_c=90), FAIL, "90"),
    ("throttling", computer(throttled=0x50005), FAIL, "voltage"),
    ("throttling", computer(throttled=0x4), FAIL, "slowed down now"),
    ("throttling", computer(throttled=0x50000), WARN, "since"),
    ("load", computer(load=1.0), WARN, "1.00"),
    ("load", computer(load=3.0), FAIL, "3.00"),
]
ONE = [
    ("px4", "COM_OF_LOSS_T", parameter("COM_OF_LOSS_T", 0.1), FAIL, "a pause of 0.1 s"),
    ("px4", "COM_OF_LOSS_T", parameter("COM_OF_LOSS_T", 0.5), WARN, "alone_s"),
    ("px4", "COM_OF_LOSS_T", parameter("COM_OF_LOSS_T", 3), WARN, "3 s"),
    ("px4", "COM_OF_LOSS_T", parameter("COM_OF_LOSS_T", 10), FAIL, "10 s"),
    ("px4", "COM_OF_LOSS_T", without("COM_OF_LOSS_T"), UNKNOWN, "does not report"),
    ("px4", "COM_OBL_RC_ACT", parameter("COM_OBL_RC_ACT", 5), PASS, "Hold"),
    ("px4", "COM_OBL_RC_ACT", parameter("COM_OBL_RC_ACT", 2), FAIL, "falls"),
    ("px4", "COM_OBL_RC_ACT", parameter("COM_OBL_RC_ACT", 7), FAIL, "motors stop"),
    ("px4", "COM_OBL_RC_ACT", parameter("COM_OBL_RC_ACT", 1), WARN, "drifts"),
    ("px4", "COM_RC_IN_MODE", parameter("COM_RC_IN_MODE", 4), FAIL, "nobody could take over"),
    ("px4", "NAV_RCL_ACT", parameter("NAV_RCL_ACT", 0), WARN, "nothing happens"),
    ("px4", "NAV_RCL_ACT", parameter("NAV_RCL_ACT", 6), FAIL, "motors stop"),
    ("px4", "COM_RCL_EXCEPT", parameter("COM_RCL_EXCEPT", 4), WARN, "ignored"),
    ("px4", "NAV_DLL_ACT", parameter("NAV_DLL_ACT", 2), WARN, "does not arm without"),
    ("px4", "MPC_ACC_HOR", parameter("MPC_ACC_HOR", 1.5), FAIL, "overrun"),
    ("px4", "MPC_XY_VEL_MAX", parameter("MPC_XY_VEL_MAX", 5), WARN, "the autopilot cuts"),
    ("px4", "MPC_Z_VEL_MAX_UP", parameter("MPC_Z_VEL_MAX_UP", 1), WARN, "2 wanted"),
    ("px4", "MPC_Z_VEL_MAX_DN", parameter("MPC_Z_VEL_MAX_DN", 1), WARN, "1.5 wanted"),
    ("px4", "MC_YAWRATE_MAX", parameter("MC_YAWRATE_MAX", 45), WARN, "60 wanted"),
    ("px4", "MPC_MAN_Y_MAX", parameter("MPC_MAN_Y_MAX", 45), WARN, "60 wanted"),
    ("ardupilot", "GUID_TIMEOUT", parameter("GUID_TIMEOUT", 3), WARN, "3 s"),
    ("ardupilot", "GUID_TIMEOUT", parameter("GUID_TIMEOUT", 0.1), FAIL, "a pause"),
    ("ardupilot", "GUID_OPTIONS", parameter("GUID_OPTIONS", 32), FAIL, "velocity"),
    ("ardupilot", "GUID_OPTIONS", parameter("GUID_OPTIONS", 16), WARN, "drift"),
    ("ardupilot", "GUID_OPTIONS", parameter("GUID_OPTIONS", 4), WARN, "yaw stick"),
    ("ardupilot", "GUID_OPTIONS", parameter("GUID_OPTIONS", 64), PASS, "measured"),
    ("ardupilot", "FS_GCS_ENABLE", parameter("FS_GCS_ENABLE", 1), WARN, "does not count"),
    ("ardupilot", "FS_THR_ENABLE", parameter("FS_THR_ENABLE", 0), WARN, "nothing happens"),
    ("ardupilot", "FS_OPTIONS", parameter("FS_OPTIONS", 20), WARN, "ignored"),
    ("ardupilot", "SYSID_MYGCS", parameter("SYSID_MYGCS", 1), FAIL, "hide"),
    ("ardupilot", "WPNAV_ACCEL", parameter("WPNAV_ACCEL", 100), FAIL, "1 m/s²"),
    ("ardupilot", "WPNAV_ACCEL_Z", parameter("WPNAV_ACCEL_Z", 50), WARN, "0.5 m/s²"),
    ("ardupilot", "WPNAV_SPEED", parameter("WPNAV_SPEED", 500), WARN, "5 m/s allowed"),
    ("ardupilot", "ATC_SLEW_YAW", parameter("ATC_SLEW_YAW", 3000), WARN, "30 deg/s"),
    ("ardupilot", "ATC_ACCEL_Y_MAX", parameter("ATC_ACCEL_Y_MAX", 9000), WARN, "270 wanted"),
    ("ardupilot", "ATC_ACCEL_Y_MAX", parameter("ATC_ACCEL_Y_MAX", 0), PASS, "unlimited"),
]


@pytest.mark.parametrize("flavour", ["px4", "ardupilot"])
def test_all_is_well_with_default_parameters(flavour: str) -> None:
    results = run_checks(healthy(flavour))
    assert [(r.check.name, r.finding) for r in results if r.finding.verdict is not PASS] == []
    named = {result.check.name for result in results}
    assert ("COM_OF_LOSS_T" in named) == (flavour == "px4")
    assert ("GUID_TIMEOUT" in named) == (flavour == "ardupilot")


@pytest.mark.parametrize(
    ("flavour", "name", "change", "verdict", "word"),
    [("px4", *case) for case in BOTH] + ONE,
    ids=lambda value: str(value) if isinstance(value, str) else None,
)
def test_each_check_says_what_is_wrong_and_what_to_do(
    flavour: str, name: str, change: Change, verdict: PreflightVerdict, word: str
) -> None:
    before, after = healthy(flavour), change(healthy(flavour))
    found = result(after, name)
    assert found.finding.verdict is verdict
    assert word in found.finding.why
    if verdict in (WARN, FAIL):
        assert found.finding.todo
    assert found.refuses == (found.check.needed and verdict in (FAIL, UNKNOWN))
    others = [(r.check.name, r.finding.verdict) for r in run_checks(after)]
    if verdict is not UNKNOWN and name not in ("vehicle", "camera", "lens", "gps"):
        assert others == [
            (r.check.name, verdict if r.check.name == name else r.finding.verdict)
            for r in run_checks(before)
        ]


def test_every_check_is_shown_failing_or_warning_somewhere() -> None:
    shown = {case[0] for case in BOTH} | {case[1] for case in ONE}
    assert {check.name for check in CHECKS} == shown


def test_a_skipped_check_does_not_refuse_and_a_wrong_name_lists_the_right_ones() -> None:
    broken = parameter("COM_OBL_RC_ACT", 7)(healthy("px4"))
    assert [one.check.name for one in run_checks(broken) if one.refuses] == ["COM_OBL_RC_ACT"]
    skip = check_names(["COM_OBL_RC_ACT"])
    assert not any(one.refuses for one in run_checks(broken, skip))
    with pytest.raises(SettingsError, match="no such check; there are vehicle, type"):
        check_names(["vehicel"])


def test_ardupilots_newer_names_and_units_are_understood() -> None:
    newer = parameter("WP_ACC", 1.0)(without("WPNAV_ACCEL")(healthy("ardupilot")))
    found = result(newer, "WPNAV_ACCEL")
    assert found.finding.verdict is FAIL
    assert "WP_ACC 1" in found.finding.why
    assert ("WPNAV_ACCEL", "WP_ACC") in parameters_for("ardupilot")


def test_with_full_autonomy_the_mode_is_ours() -> None:
    base = vehicle(obeys_setpoints=True, armed=True)(healthy("px4"))
    full = base.settings.model_copy(update={"autonomy": "full"})
    assert result(replace(base, settings=full), "mode").finding.verdict is PASS


def test_a_failed_check_that_is_not_needed_is_a_warning_at_the_end() -> None:
    shown = io.StringIO()
    print_checklist(Console(file=shown, width=120), run_checks(computer(load=3.0)(healthy("px4"))))
    assert shown.getvalue().rstrip().endswith("Ready, 1 warning")
    assert "fail, optional" in shown.getvalue()
    refused = io.StringIO()
    broken = camera(frames=0, problem="the stream ended")(healthy("px4"))
    print_checklist(Console(file=refused, width=120), run_checks(broken))
    assert "Do not fly" in refused.getvalue()
    assert "camera: the stream ended; is the camera plugged in" in refused.getvalue()


def test_without_a_vehicle_one_line_names_all_that_it_would_have_to_say() -> None:
    shown = io.StringIO()
    results = run_checks(link(vehicle_id=None)(healthy("px4")))
    print_checklist(Console(file=shown, width=120), results)
    said = [line for line in shown.getvalue().splitlines() if "no vehicle is heard" in line]
    assert said[-1].startswith("  type, attitude-rate, position-rate, ")
    refused = sum(result.refuses for result in results)
    assert f"{refused} checks failed" in shown.getvalue()
    assert result(link(vehicle_id=None)(healthy("px4")), "mode").finding.verdict is UNKNOWN


def test_where_the_vehicle_is_stays_open_while_the_autopilot_does_not_say_it() -> None:
    assert result(vehicle(landed=None)(healthy("px4")), "mode").finding.why.endswith("disarmed")


def test_json_holds_every_check_and_no_infinities() -> None:
    snapshot = camera(age_s=math.nan)(healthy("px4"))
    content = json.loads(to_json(run_checks(snapshot), snapshot), parse_constant=pytest.fail)
    assert content["ready"] is False
    assert {check["name"] for check in content["checks"]} >= {"vehicle", "COM_OF_LOSS_T"}
    assert content["camera"]["age_s"] is None


def test_the_pages_list_is_that_of_the_program() -> None:
    assert CHECK_LIST.now() == CHECK_LIST.renewed(), "python tests/docs_tables/preflight_checks.py"
