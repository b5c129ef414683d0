"""The simulated multirotor: signs, physics, determinism."""

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from follower_sim.kinematics import BodyState, Triple
from follower_sim.vehicle.gimbal import Gimbal, GimbalModel
from follower_sim.vehicle.response import (
    ARDUCOPTER_RESPONSE,
    PX4_RESPONSE,
    STAND_STILL,
    Demand,
    Drag,
    VehicleResponse,
)
from follower_sim.vehicle.vehicle import STEP_S, SimulatedVehicle, WindField

RESPONSES = {"px4": PX4_RESPONSE, "ardupilot": ARDUCOPTER_RESPONSE}
both = pytest.mark.parametrize("response", RESPONSES.values(), ids=RESPONSES.keys())


def hovering(response: VehicleResponse, wind: WindField | None = None) -> SimulatedVehicle:
    return SimulatedVehicle(response, BodyState(0.0, (0.0, 0.0, -20.0)), wind)


def fly(vehicle: SimulatedVehicle, seconds: float, demand: Demand) -> list[BodyState]:
    states = []
    for _ in range(round(seconds / STEP_S)):
        vehicle.step(demand)
        states.append(vehicle.state)
    return states


@both
def test_nothing_asked_nothing_done(response: VehicleResponse) -> None:
    vehicle = hovering(response)
    fly(vehicle, 5.0, STAND_STILL)
    assert vehicle.state.position_m == pytest.approx((0.0, 0.0, -20.0), abs=1e-9)
    assert vehicle.state.time_s == pytest.approx(5.0)


@both
def test_wind_does_not_move_it_on_the_ground(response: VehicleResponse) -> None:
    vehicle = SimulatedVehicle(response, BodyState(0.0, (0.0, 0.0, 0.0)), lambda _: (10, 5, -1))
    states = fly(vehicle, 1.0, STAND_STILL)
    assert {state.position_m for state in states} == {(0.0, 0.0, 0.0)}


@both
def test_position_is_the_integral_of_velocity_and_yaw_that_of_its_rate(
    response: VehicleResponse,
) -> None:
    vehicle = hovering(response)
    states = fly(vehicle, 4.0, Demand((2.0, -1.0, 0.5), 0.4))
    for axis in range(3):
        integral = sum(state.velocity_m_s[axis] for state in states) * STEP_S
        moved = vehicle.state.position_m[axis] - (0.0, 0.0, -20.0)[axis]
        assert moved == pytest.approx(integral, abs=1e-6)
    # While it stands level again, body rate and heading rate are the same.
    fly(vehicle, 8.0, STAND_STILL)
    before = vehicle.state.yaw_rad
    turning = fly(vehicle, 2.0, Demand(yaw_rate_rad_s=0.4))
    turned = sum(state.rates_rad_s[2] for state in turning) * STEP_S
    assert vehicle.state.yaw_rad - before == pytest.approx(turned, abs=0.01)


@both
def test_velocity_changes_by_gravity_times_tilt_less_drag(response: VehicleResponse) -> None:
    vehicle = hovering(response)
    fly(vehicle, 0.4, Demand((3.0, 0.0, 0.0)))
    a = vehicle.state
    vehicle.step(Demand((3.0, 0.0, 0.0)))
    b = vehicle.state
    thrust = -9.80665 * math.tan(b.attitude_rad[1])
    speed = a.velocity_m_s[0]
    drag = (response.drag.linear_per_s + response.drag.quadratic_per_m * speed) * speed
    assert (b.velocity_m_s[0] - speed) / STEP_S == pytest.approx(thrust - drag, abs=0.01)


@both
def test_tilt_keeps_its_limit_and_the_mirror_image(response: VehicleResponse) -> None:
    there, back = hovering(response), hovering(response)
    forward = fly(there, 3.0, Demand((12.0, 5.0, 0.0)))
    backward = fly(back, 3.0, Demand((-12.0, -5.0, 0.0)))
    for a, b in zip(forward, backward, strict=True):
        assert a.velocity_m_s == pytest.approx(tuple(-v for v in b.velocity_m_s), abs=1e-9)
    tilts = [math.acos(math.cos(s.attitude_rad[0]) * math.cos(s.attitude_rad[1])) for s in forward]
    assert math.degrees(max(tilts)) < 1.1 * response.tilt.max_tilt_deg


@pytest.mark.slow
@both
def test_a_steady_wind_is_leant_against(response: VehicleResponse) -> None:
    vehicle = hovering(response, lambda _: (0.0, 5.0, 0.0))
    fly(vehicle, 40.0, STAND_STILL)
    assert math.hypot(*vehicle.state.velocity_m_s) < 0.05
    assert math.degrees(vehicle.state.attitude_rad[0]) < -5.0


@pytest.mark.slow
def test_what_was_asked_in_vain_against_the_wind_is_not_made_up_for_afterwards() -> None:
    light = replace(ARDUCOPTER_RESPONSE, drag=Drag(0.25, 0.01, 0.3))
    vehicle = hovering(light, lambda _: (-10.0, 0.0, 0.0))
    fly(vehicle, 15.0, Demand((9.0, 0.0, 0.0), 0.0))
    before = vehicle.state
    assert before.velocity_m_s[0] < 6.0, "the wind holds it back"
    assert math.degrees(before.attitude_rad[1]) < -0.95 * light.tilt.max_tilt_deg
    farthest = max(state.position_m[0] for state in fly(vehicle, 6.0, STAND_STILL))
    assert farthest - before.position_m[0] < 2.5 * before.velocity_m_s[0]


@both
def test_gusts_shake_it_a_little(response: VehicleResponse) -> None:
    vehicle = hovering(response, lambda t: (2.0 * math.sin(1.7 * t), 0.0, 0.0))
    speeds = [abs(s.velocity_m_s[0]) for s in fly(vehicle, 20.0, STAND_STILL)]
    assert 0.01 < max(speeds) < 1.2


@both
def test_the_ground_carries_it_until_it_is_asked_to_climb(response: VehicleResponse) -> None:
    vehicle = SimulatedVehicle(
        response, BodyState(0.0, (0.0, 0.0, 0.0), attitude_rad=(0.0, 0.0, 1.0))
    )
    assert not vehicle.motors_on
    fly(vehicle, 1.0, Demand((0.0, 0.0, -1.0)))
    assert vehicle.on_ground  # the motors are off
    vehicle.motors_on = True
    fly(vehicle, 1.0, Demand((2.0, 0.0, 1.0), 0.5))
    assert vehicle.state.position_m == (0.0, 0.0, 0.0)
    assert vehicle.state.yaw_rad == 1.0
    fly(vehicle, 3.0, Demand((0.0, 0.0, -1.0)))
    assert vehicle.state.position_m[2] < -1.5
    fly(vehicle, 6.0, Demand((0.0, 0.0, 1.0)))
    assert vehicle.on_ground
    assert vehicle.state.velocity_m_s == (0.0, 0.0, 0.0)


@both
def test_with_the_motors_off_it_falls(response: VehicleResponse) -> None:
    vehicle = SimulatedVehicle(
        replace(response, drag=Drag(0.0, 0.0, 0.0)), BodyState(0.0, (0, 0, -20.0))
    )
    vehicle.motors_on = False
    fly(vehicle, 1.0, STAND_STILL)
    assert vehicle.state.velocity_m_s[2] == pytest.approx(9.80665)
    fly(vehicle, 2.0, STAND_STILL)
    assert vehicle.on_ground


@both
def test_history_lies_between_the_steps(response: VehicleResponse) -> None:
    vehicle = SimulatedVehicle(
        response, BodyState(10.0, (0, 0, -20.0), attitude_rad=(0.0, 0.0, 3.1))
    )
    states = fly(vehicle, 1.0, Demand((3.0, 0.0, 0.0), 0.6))
    a, b = states[150], states[151]
    middle = vehicle.state_at((a.time_s + b.time_s) / 2)
    assert middle.position_m[0] == pytest.approx((a.position_m[0] + b.position_m[0]) / 2)
    assert vehicle.state_at(a.time_s).position_m == pytest.approx(a.position_m, abs=1e-9)
    assert vehicle.state_at(99.0) == vehicle.state
    assert vehicle.state_at(-99.0).time_s == 10.0
    crossing = next(s for s in states if s.yaw_rad < 0)
    just_before = vehicle.state_at(crossing.time_s - STEP_S / 2)
    assert abs(just_before.yaw_rad) > 3.1  # interpolated the short way round


def test_history_keeps_two_seconds() -> None:
    vehicle = hovering(PX4_RESPONSE)
    fly(vehicle, 5.0, Demand((1.0, 0.0, 0.0)))
    assert vehicle.state_at(3.2).time_s == pytest.approx(3.2)
    assert vehicle.state_at(1.0).time_s > 2.9


demands = st.builds(
    Demand,
    st.tuples(st.floats(-12, 12), st.floats(-12, 12), st.floats(-3, 3)),
    st.floats(-3.5, 3.5),
)


def _gust(time_s: float) -> Triple:
    return 4.0 * math.sin(time_s), 4.0 * math.cos(2 * time_s), math.sin(3 * time_s)


@pytest.mark.slow
@settings(max_examples=15)
@given(st.sampled_from(list(RESPONSES)), st.lists(demands, min_size=1, max_size=10))
def test_no_sequence_of_demands_makes_it_diverge(flavour: str, sequence: list[Demand]) -> None:
    vehicle = hovering(RESPONSES[flavour], _gust)
    for demand in sequence:
        fly(vehicle, 0.4, demand)
    north, east, down = vehicle.state.velocity_m_s
    assert math.hypot(north, east) < 25.0
    assert abs(down) < 6.0
    assert max(abs(x) for x in vehicle.state.attitude_rad[:2]) < math.radians(60.0)
    fly(vehicle, 15.0, STAND_STILL)
    assert math.hypot(*vehicle.state.velocity_m_s) < 2.5


@pytest.mark.parametrize("drag", [(-1.0, 0.0, 0.0), (1e6, 0.0, 0.0), (0.0, 1e6, 0.0)])
def test_drag_that_pulls_or_stops_it_within_a_step_is_refused(
    drag: tuple[float, float, float],
) -> None:
    with pytest.raises(ValueError, match="lies between 0 and"):
        Drag(*drag)


def test_less_drag_needs_less_tilt_to_stand_in_the_wind() -> None:
    def tilt_deg(drag: Drag) -> float:
        vehicle = hovering(replace(PX4_RESPONSE, drag=drag), lambda _: (8.0, 0.0, 0.0))
        return math.degrees(abs(fly(vehicle, 15.0, STAND_STILL)[-1].attitude_rad[1]))

    level_m_s2 = 8 * (0.25 + 8 * 0.01)
    expected_deg = math.degrees(math.atan2(level_m_s2, 9.80665))
    assert tilt_deg(Drag(0.25, 0.01, 0.3)) == pytest.approx(expected_deg, abs=1.5)
    assert tilt_deg(PX4_RESPONSE.drag) > 35


def test_a_gimbal_that_is_taken_along_at_its_end_stop_turns_and_says_so() -> None:
    gimbal = Gimbal(GimbalModel(widest_deg=10.0), math.radians(-30), 0.0, 0.0)
    for step in range(1, 201):
        gimbal.step(step * STEP_S, STEP_S, 1.0 * step * STEP_S)
    turned_rad = gimbal.at(1.0).attitude_rad[2] - gimbal.at(0.5).attitude_rad[2]
    assert turned_rad / 0.5 == pytest.approx(1.0)
    forward, down = math.sin(math.radians(30)), math.cos(math.radians(30))
    assert gimbal.state.rates_rad_s == pytest.approx((forward, 0.0, down))
