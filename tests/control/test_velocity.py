"""Where a stream of setpoints begins: at the vehicle's motion, by telemetry that may be wrong."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_control.vehicle.setpoint import HOLD
from follower_control.vehicle.state import (
    Attitude,
    LocalPosition,
    PresentMotion,
    VehicleState,
    heading_velocity,
)

YAW_RAD = 0.7


def told(north_m_s: float, time_s: float, yaw_rate_rad_s: float = 0.1) -> VehicleState:
    attitude = Attitude(0.0, 0.0, YAW_RAD, 0.0, 0.0, yaw_rate_rad_s, time_s)
    return VehicleState(attitude, LocalPosition(0, 0, -10, north_m_s, -1.0, 0.5, time_s))


def heard(*vehicles: VehicleState) -> PresentMotion:
    motion = PresentMotion()
    for vehicle in vehicles:
        motion.update(vehicle)
    return motion


def test_nothing_known_is_standing_still() -> None:
    assert PresentMotion().present == HOLD


@given(st.lists(st.floats(-0.1, 0.1), min_size=1, max_size=20))
def test_telemetry_that_agrees_with_itself_is_taken_as_it_is(changes: list[float]) -> None:
    speed_m_s, vehicles = 3.0, []
    for number, change in enumerate(changes):
        speed_m_s += change
        vehicles.append(told(speed_m_s, 0.1 * number))
    assert heard(*vehicles).present == heading_velocity(vehicles[-1])


@pytest.mark.parametrize("glitch_m_s", [9.0, -9.0, 30.0, 1e30])
def test_one_velocity_far_from_the_last_is_not_begun_with(glitch_m_s: float) -> None:
    good = [told(0.1, 0.1 * number) for number in range(6)]
    assert heard(*good, told(glitch_m_s, 0.6)).present == heading_velocity(good[-1])
    later = [told(0.2, 0.7), told(0.2, 0.8)]
    assert heard(*good, told(glitch_m_s, 0.6), *later).present == heading_velocity(later[-1])


def test_one_yaw_rate_far_from_the_last_is_not_begun_with() -> None:
    good = [told(0.1, 0.1 * number) for number in range(6)]
    assert heard(*good, told(0.1, 0.6, 1000.0)).present.yaw_rate_rad_s == 0.1


def test_a_velocity_that_lasts_is_believed() -> None:
    good = [told(0.1, 0.1 * number) for number in range(6)]
    fast = [told(6.0, 0.6 + 0.1 * number) for number in range(3)]
    north_m_s = heard(*good, *fast).present.forward_m_s
    assert north_m_s == pytest.approx(6 * math.cos(YAW_RAD) - math.sin(YAW_RAD))
