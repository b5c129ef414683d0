"""What setpoints do to the simulated autopilot, in both flavours."""

import math

import pytest
from autopilot_flight import (
    ACCEPTED,
    FLAVOURS,
    HEADING_DEG,
    REJECTED,
    SETPOINT_MODE,
    VELOCITY_AND_YAW_RATE,
    Flight,
    engaged,
    velocity,
)
from pymavlink.dialects.v20 import common as mavlink


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize(
    ("asked", "course_deg"),
    [
        ((3.0, 0.0), HEADING_DEG),
        ((-3.0, 0.0), HEADING_DEG - 180.0),
        ((0.0, 3.0), HEADING_DEG + 90.0),
        ((0.0, -3.0), HEADING_DEG - 90.0),
    ],
)
def test_body_velocities_follow_the_heading(
    flavour: str, asked: tuple[float, float], course_deg: float
) -> None:
    flight = engaged(flavour)
    flight.run(6.0, velocity(*asked))
    assert flight.speed_m_s == pytest.approx(2.8, abs=0.25)
    assert flight.course_deg == pytest.approx(course_deg, abs=1.5)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_down_is_positive_and_changes_nothing_else(flavour: str) -> None:
    for sign in (1.0, -1.0):
        flight = engaged(flavour)
        flight.run(4.0, velocity(down=sign))
        assert flight.autopilot.state.velocity_m_s[2] == pytest.approx(sign, rel=0.2)
        assert flight.speed_m_s < 0.01
        assert flight.yaw_deg == pytest.approx(HEADING_DEG, abs=0.5)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_a_positive_yaw_rate_turns_clockwise(flavour: str) -> None:
    flight = engaged(flavour)
    flight.run(3.0, velocity(yaw_rate=math.radians(30.0)))
    assert flight.yaw_deg == pytest.approx(HEADING_DEG + 81.0, abs=6.0)
    assert math.degrees(flight.autopilot.state.rates_rad_s[2]) == pytest.approx(30.0, rel=0.05)


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_it_pitches_down_to_go_forward_and_rolls_right_to_go_right(flavour: str) -> None:
    flight = engaged(flavour)
    flight.run(0.7, velocity(3.0, 3.0))
    roll, pitch, _ = flight.autopilot.state.attitude_rad
    assert math.degrees(pitch) < -5.0
    assert math.degrees(roll) > 5.0


@pytest.mark.parametrize(
    ("flavour", "frame", "course_deg"),
    [
        ("ardupilot", 1, 0.0),
        ("ardupilot", 7, 0.0),
        ("ardupilot", 8, HEADING_DEG),
        ("ardupilot", 9, HEADING_DEG),
        ("px4", 1, 0.0),
        ("px4", 8, HEADING_DEG),
    ],
)
def test_frames_that_fly(flavour: str, frame: int, course_deg: float) -> None:
    flight = engaged(flavour)
    flight.run(6.0, velocity(3.0, frame=frame))
    assert flight.speed_m_s > 2.5
    assert flight.course_deg == pytest.approx(course_deg, abs=1.5)


@pytest.mark.parametrize("frame", [7, 9, 12])
def test_px4_answers_other_frames_with_a_complaint_each_and_then_its_failsafe(frame: int) -> None:
    flight = engaged("px4")
    flight.run(2.0, velocity(3.0, frame=frame))
    assert flight.texts.count(
        f"SET_POSITION_TARGET_LOCAL_NED coordinate frame {frame} unsupported"[:50]
    ) == pytest.approx(100, abs=1)
    assert "Failsafe activated" in flight.texts
    assert flight.autopilot.mode == "RTL"


def test_without_yaw_ardupilot_spins_in_a_sideways_command_and_px4_keeps_its_heading() -> None:
    spinning, holding = engaged("ardupilot"), engaged("px4")
    for flight in (spinning, holding):
        flight.run(4.0, velocity(0.0, 3.0, mask=0xDC7))
    assert math.degrees(spinning.autopilot.state.rates_rad_s[2]) == pytest.approx(60.0, abs=8.0)
    assert holding.yaw_deg == pytest.approx(HEADING_DEG, abs=2.0)


def test_with_yaw_ardupilot_spins_in_a_body_frame_and_px4_turns_there() -> None:
    spinning, turning = engaged("ardupilot"), engaged("px4")
    for flight in (spinning, turning):
        flight.run(6.0, velocity(0.0, mask=0x9C7, yaw=math.radians(100.0)))
    assert math.degrees(spinning.autopilot.state.rates_rad_s[2]) == pytest.approx(60.0, abs=8.0)
    assert turning.yaw_deg == pytest.approx(100.0, abs=2.0)


@pytest.mark.slow
def test_ignoring_the_vertical_velocity_stops_ardupilot_and_fails_px4_safe() -> None:
    ardupilot, px4 = engaged("ardupilot"), engaged("px4")
    for flight in (ardupilot, px4):
        flight.run(5.0, velocity(3.0))
        flight.run(5.0, velocity(3.0, mask=VELOCITY_AND_YAW_RATE | 0x20))
    assert ardupilot.speed_m_s < 0.15
    assert ardupilot.autopilot.mode == "GUIDED"
    assert px4.autopilot.mode == "RTL"


def test_mask_0_flies_on_with_ardupilot_and_home_with_px4() -> None:
    ardupilot, px4 = engaged("ardupilot"), engaged("px4")
    for flight in (ardupilot, px4):
        flight.run(8.0, velocity(3.0, frame=1))
        flight.run(8.0, velocity(3.0, frame=1, mask=0))
    assert ardupilot.autopilot.state.velocity_m_s[0] == pytest.approx(2.9, abs=0.2)
    assert px4.autopilot.state.position_m[2] > -12.0


@pytest.mark.parametrize("flavour", FLAVOURS)
def test_velocities_that_are_not_finite_stop_it(flavour: str) -> None:
    flight = engaged(flavour)
    flight.run(4.0, velocity(3.0))
    flight.run(8.0, velocity(math.nan))
    assert flight.speed_m_s < 0.4
    assert flight.autopilot.mode == SETPOINT_MODE[flavour]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("flavour", "horizontal", "up", "down", "yaw_deg_s"),
    [("ardupilot", 10.2, 4.9, 5.2, 60.0), ("px4", 9.8, 2.9, 1.5, 193.0)],
)
def test_what_is_too_fast_is_clipped_as_recorded(
    flavour: str, horizontal: float, up: float, down: float, yaw_deg_s: float
) -> None:
    asked = [velocity(20.0), velocity(down=-5.0), velocity(down=5.0), velocity(yaw_rate=3.5)]
    flights = [Flight(flavour, height_m=60.0) for _ in asked]
    for flight, message in zip(flights, asked, strict=True):
        flight.engage()
        flight.run(9.0, message)
    fast, climbing, sinking, turning = flights
    assert fast.speed_m_s == pytest.approx(horizontal, rel=0.05)
    assert -climbing.autopilot.state.velocity_m_s[2] == pytest.approx(up, rel=0.15)
    assert sinking.autopilot.state.velocity_m_s[2] == pytest.approx(down, rel=0.15)
    rate = math.degrees(turning.autopilot.state.rates_rad_s[2])
    assert rate == pytest.approx(yaw_deg_s, rel=0.05)


@pytest.mark.parametrize("flavour", FLAVOURS)
@pytest.mark.parametrize(
    ("system", "component", "obeyed"),
    [(1, 1, True), (1, 0, True), (0, 0, True), (2, 1, False), (1, 190, False), (255, 0, False)],
)
def test_addresses(flavour: str, system: int, component: int, obeyed: bool) -> None:
    flight = engaged(flavour)
    flight.run(1.0, velocity(3.0, system=system, component=component))
    assert (flight.speed_m_s > 1.0) is obeyed
    assert flight.texts == []


@pytest.mark.slow
def test_ardupilot_flies_on_for_three_seconds_and_stops_after_11_8_m() -> None:
    flight = engaged("ardupilot")
    flight.run(8.0, velocity(3.0))
    start = flight.autopilot.state.position_m
    flight.run(2.9)
    assert flight.speed_m_s == pytest.approx(3.0, abs=0.1)
    flight.run(2.1)
    assert flight.speed_m_s < 0.25
    assert math.dist(start, flight.autopilot.state.position_m) == pytest.approx(11.8, rel=0.05)
    assert (flight.autopilot.mode, flight.texts) == ("GUIDED", [])
    flight.run(3.0, velocity(3.0))
    assert flight.speed_m_s > 2.5


def test_ardupilots_timeout_is_a_parameter() -> None:
    flight = engaged("ardupilot")
    flight.companion.send(mavlink.MAVLink_param_set_message(1, 1, b"GUID_TIMEOUT", 0.5, 9))
    flight.run(8.0, velocity(3.0))
    start = flight.autopilot.state.position_m
    flight.run(3.0)
    assert flight.of("PARAM_VALUE")[0].param_value == 0.5
    assert math.dist(start, flight.autopilot.state.position_m) == pytest.approx(4.4, rel=0.05)


def test_px4_returns_home_after_a_second_and_comes_back_with_the_stream() -> None:
    flight = engaged("px4")
    flight.run(8.0, velocity(3.0))
    speed = flight.speed_m_s
    flight.run(0.98)
    assert flight.autopilot.mode == "OFFBOARD"
    lost_s = 0.98
    while flight.speed_m_s > 0.9 * speed:
        flight.run(0.02)
        lost_s += 0.02
    assert lost_s == pytest.approx(1.68, rel=0.1)
    assert (flight.autopilot.mode, flight.texts) == ("RTL", ["Failsafe activated"])
    flight.run(1.0, velocity(3.0))
    assert flight.autopilot.mode == "OFFBOARD"


def test_px4_does_not_come_back_once_the_pilot_has_chosen_a_mode() -> None:
    flight = engaged("px4")
    flight.run(3.0)
    assert flight.autopilot.mode == "RTL"
    flight.autopilot.switch_mode("POSCTL")
    flight.run(2.0, velocity(3.0))
    assert flight.autopilot.mode == "POSCTL"
    assert flight.speed_m_s < 0.3


@pytest.mark.parametrize(
    ("flavour", "rate_hz", "stays"),
    [("px4", 10, True), ("px4", 1, True), ("px4", 0.5, False), ("ardupilot", 0.5, True)],
)
def test_slow_streams(flavour: str, rate_hz: float, stays: bool) -> None:
    flight = engaged(flavour)
    flight.run(12.0, velocity(2.0), every=round(50 / rate_hz))
    assert (flight.autopilot.mode == SETPOINT_MODE[flavour]) is stays
    if stays:
        assert flight.speed_m_s == pytest.approx(1.9, abs=0.2)


def test_px4_refuses_offboard_without_a_stream_and_ardupilot_takes_guided() -> None:
    px4, ardupilot = Flight("px4"), Flight("ardupilot")
    assert px4.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 6.0, 0.0) == REJECTED
    assert px4.autopilot.mode == "LOITER"
    assert len(px4.texts) == 1
    assert ardupilot.command(mavlink.MAV_CMD_DO_SET_MODE, 1.0, 4.0) == ACCEPTED
    assert ardupilot.autopilot.mode == "GUIDED"
