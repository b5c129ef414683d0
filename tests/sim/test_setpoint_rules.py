"""The table of frames and masks in facts/autopilots.md, row by row, without flying."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_sim.autopilot.arducopter import arducopter_setpoint
from follower_sim.autopilot.flight_controller import STOP, PositionTarget, Setpoint
from follower_sim.autopilot.px4 import px4_setpoint

VELOCITY_AND_YAW_RATE = 0x5C7
VELOCITY_ALONE = 0xDC7
VELOCITY_AND_YAW = 0x9C7
WITHOUT_DOWN = VELOCITY_AND_YAW_RATE | 0x20
HEADING = math.radians(60.0)
HERE = (10.0, 20.0, -15.0)


def target(
    frame: int,
    mask: int = VELOCITY_AND_YAW_RATE,
    velocity: tuple[float, float, float] = (3.0, 0.0, 0.0),
    yaw: float = 0.5,
    yaw_rate: float = 0.25,
) -> PositionTarget:
    return PositionTarget(frame, mask, (0.0, 0.0, 0.0), velocity, yaw, yaw_rate)


def ardupilot(message: PositionTarget) -> Setpoint | None:
    return arducopter_setpoint(message, HEADING, HERE)


def px4(message: PositionTarget) -> Setpoint | str:
    return px4_setpoint(message, HEADING)


@pytest.mark.parametrize("frame", [8, 9])
def test_ardupilot_turns_body_frames_by_the_heading(frame: int) -> None:
    setpoint = ardupilot(target(frame))
    assert isinstance(setpoint, Setpoint)
    assert setpoint.velocity_m_s == pytest.approx((1.5, 3 * math.sin(HEADING), 0.0))
    assert setpoint.yaw_rate_rad_s == 0.25


@pytest.mark.parametrize("frame", [1, 7])
def test_ardupilot_takes_local_frames_as_they_are(frame: int) -> None:
    setpoint = ardupilot(target(frame, velocity=(1.0, 2.0, 0.5)))
    assert isinstance(setpoint, Setpoint)
    assert setpoint.velocity_m_s == (1.0, 2.0, 0.5)


def test_px4_flies_frames_1_and_8() -> None:
    local, body = px4(target(1)), px4(target(8, velocity=(0.0, 3.0, 0.0)))
    assert isinstance(local, Setpoint)
    assert isinstance(body, Setpoint)
    assert local.velocity_m_s == (3.0, 0.0, 0.0)
    assert body.velocity_m_s == pytest.approx((-3 * math.sin(HEADING), 1.5, 0.0))


@pytest.mark.parametrize("frame", [0, 7, 9, 12])
def test_px4_complains_of_every_other_frame(frame: int) -> None:
    assert px4(target(frame)) == (
        f"SET_POSITION_TARGET_LOCAL_NED coordinate frame {frame} unsupported"
    )


def test_ardupilot_leaves_out_unknown_frames_in_silence() -> None:
    assert ardupilot(target(12)) is None


def test_velocity_without_yaw_turns_ardupilots_nose_and_keeps_px4s() -> None:
    turning, holding = ardupilot(target(8, VELOCITY_ALONE)), px4(target(8, VELOCITY_ALONE))
    assert isinstance(turning, Setpoint)
    assert isinstance(holding, Setpoint)
    assert turning.faces_velocity
    assert turning.yaw_rate_rad_s is None
    assert not holding.faces_velocity
    assert holding.yaw_rate_rad_s == 0.0


def test_yaw_is_relative_for_ardupilot_in_a_body_frame_and_absolute_for_px4() -> None:
    relative, absolute = ardupilot(target(8, VELOCITY_AND_YAW)), px4(target(8, VELOCITY_AND_YAW))
    local = ardupilot(target(1, VELOCITY_AND_YAW))
    assert isinstance(relative, Setpoint)
    assert isinstance(absolute, Setpoint)
    assert isinstance(local, Setpoint)
    assert relative.yaw_rad == pytest.approx(HEADING + 0.5)
    assert absolute.yaw_rad == pytest.approx(0.5)
    assert local.yaw_rad == pytest.approx(0.5)


def test_ignoring_the_vertical_velocity_alone_stops_ardupilot_and_is_invalid_for_px4() -> None:
    assert ardupilot(target(8, WITHOUT_DOWN)) == STOP
    assert px4(target(8, WITHOUT_DOWN)) == "SET_POSITION_TARGET_LOCAL_NED invalid"


def test_mask_0_flies_the_velocity_on_ardupilot_and_to_the_origin_on_px4() -> None:
    flying, going = ardupilot(target(1, 0)), px4(target(1, 0))
    assert isinstance(flying, Setpoint)
    assert isinstance(going, Setpoint)
    assert flying.position_m is None
    assert flying.velocity_m_s == (3.0, 0.0, 0.0)
    assert going.position_m == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_a_velocity_that_is_not_finite_stops_both(number: float) -> None:
    assert ardupilot(target(8, velocity=(number, 0.0, 0.0))) == STOP
    assert px4(target(8, velocity=(number, 0.0, 0.0))) == STOP


def test_a_yaw_rate_that_is_not_a_number_is_left_out_by_both() -> None:
    for setpoint in (ardupilot(target(8, yaw_rate=math.nan)), px4(target(8, yaw_rate=math.nan))):
        assert isinstance(setpoint, Setpoint)
        assert setpoint.yaw_rate_rad_s == 0.0
        assert setpoint.velocity_m_s == pytest.approx((1.5, 3 * math.sin(HEADING), 0.0))


def test_ardupilot_takes_a_position_as_an_offset_in_the_offset_frames() -> None:
    mask = 0xDF8
    by_frame = {
        frame: arducopter_setpoint(
            PositionTarget(frame, mask, (5.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.0, 0.0),
            math.pi / 2,
            HERE,
        )
        for frame in (1, 7, 9)
    }
    places = {f: s.position_m for f, s in by_frame.items() if isinstance(s, Setpoint)}
    assert places[1] == pytest.approx((5.0, 0.0, 1.0))
    assert places[7] == pytest.approx((15.0, 20.0, -14.0))
    assert places[9] == pytest.approx((10.0, 25.0, -14.0))


any_float = st.floats(width=32)


@given(
    st.integers(0, 255),
    st.integers(0, 0xFFFF),
    st.tuples(any_float, any_float, any_float),
    st.tuples(any_float, any_float, any_float),
    any_float,
    any_float,
)
def test_no_message_whatever_leads_to_a_setpoint_that_is_not_finite(
    frame: int,
    mask: int,
    position: tuple[float, float, float],
    velocity: tuple[float, float, float],
    yaw: float,
    yaw_rate: float,
) -> None:
    message = PositionTarget(frame, mask, position, velocity, yaw, yaw_rate)
    for result in (ardupilot(message), px4(message)):
        if isinstance(result, Setpoint):
            numbers = [*result.velocity_m_s, *(result.position_m or ())]
            numbers += [x for x in (result.yaw_rate_rad_s, result.yaw_rad) if x is not None]
            assert all(map(math.isfinite, numbers))
