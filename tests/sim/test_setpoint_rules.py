"""Rules of frames and masks that `test_autopilot_setpoints.py` does not fly."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_sim.autopilot.arducopter import arducopter_setpoint
from follower_sim.autopilot.flight_controller import PositionTarget, Setpoint
from follower_sim.autopilot.px4 import px4_setpoint

VELOCITY_AND_YAW_RATE = 0x5C7
VELOCITY_AND_YAW = 0x9C7
HEADING = math.radians(60.0)
HERE = (10.0, 20.0, -15.0)


def target(
    frame: int,
    mask: int = VELOCITY_AND_YAW_RATE,
    yaw_rate: float = 0.25,
) -> PositionTarget:
    return PositionTarget(frame, mask, (0.0, 0.0, 0.0), (3.0, 0.0, 0.0), 0.5, yaw_rate)


def ardupilot(message: PositionTarget) -> Setpoint | None:
    return arducopter_setpoint(message, HEADING, HERE)


def px4(message: PositionTarget) -> Setpoint | str:
    return px4_setpoint(message, HEADING)


def test_ardupilot_leaves_out_unknown_frames_in_silence() -> None:
    assert ardupilot(target(12)) is None


def test_yaw_is_relative_for_ardupilot_in_a_body_frame_and_absolute_for_px4() -> None:
    relative, absolute = ardupilot(target(8, VELOCITY_AND_YAW)), px4(target(8, VELOCITY_AND_YAW))
    local = ardupilot(target(1, VELOCITY_AND_YAW))
    assert relative.yaw_rad == pytest.approx(HEADING + 0.5)
    assert absolute.yaw_rad == pytest.approx(0.5)
    assert local.yaw_rad == pytest.approx(0.5)


def test_a_yaw_rate_that_is_not_a_number_is_left_out_by_both() -> None:
    for setpoint in (ardupilot(target(8, yaw_rate=math.nan)), px4(target(8, yaw_rate=math.nan))):
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
