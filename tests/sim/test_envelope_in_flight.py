"""The envelope in flight: both simulated autopilots never leave the polygon, whatever is asked."""

import cmath
import math
from dataclasses import replace
from itertools import pairwise

import hypothesis.strategies as st
import pytest
from hypothesis import Phase, example, given, settings

from follower_control.envelope.envelope import Envelope
from follower_control.envelope.fence import Fence
from follower_control.envelope.flight_context import FlightContext
from follower_control.envelope.settings import EnvelopeSettings
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_sim.autopilot.firmware import ARDUCOPTER, PX4
from follower_sim.kinematics import BodyState
from follower_sim.vehicle.response import Demand
from follower_sim.vehicle.vehicle import STEP_S, SimulatedVehicle

CONTROL_STEPS = 4
NOTCHED = ((-40.0, -40.0), (-40.0, 40.0), (40.0, 40.0), (0.0, 0.0), (40.0, -40.0))
SETTINGS = EnvelopeSettings(fence_m=NOTCHED, fence_radius_m=None, min_distance_m=None)

wishes = st.builds(
    VelocitySetpoint, st.floats(-12, 12), st.floats(-12, 12), st.floats(-3, 3), st.floats(-1.2, 1.2)
)
manoeuvres = st.lists(st.tuples(wishes, st.floats(0.3, 6.0)), min_size=1, max_size=5)
starts = st.tuples(st.floats(-35, -5), st.floats(-35, 35), st.floats(-math.pi, math.pi))

FEW = settings(
    max_examples=8,
    derandomize=True,
    database=None,
    phases=(Phase.explicit, Phase.generate),
)
"""A flight takes a good part of a second: no looking for a simpler one that fails."""


def fly(firmware, start, manoeuvre, limits=SETTINGS) -> list[BodyState]:
    """Ask for one velocity after the other and then to hold; return the way."""
    north, east, yaw = start
    body = BodyState(0.0, (north, east, -12.0), attitude_rad=(0.0, 0.0, yaw))
    vehicle, envelope = SimulatedVehicle(firmware.response, body), Envelope(limits)
    envelope.start(HOLD, 0.0)
    way, step = [vehicle.state], 0
    for asked, seconds in (*manoeuvre, (HOLD, 1.0)):
        for _ in range(round(seconds / STEP_S / CONTROL_STEPS)):
            state = vehicle.state
            north, east, down = state.position_m
            moved = {"north_m_s": state.velocity_m_s[0], "east_m_s": state.velocity_m_s[1]}
            context = FlightContext(state.yaw_rad, north, east, -down, **moved)
            allowed = envelope.limit(asked, step * STEP_S, context).allowed
            for _ in range(CONTROL_STEPS):
                vehicle.step(demand(allowed, vehicle.state.yaw_rad))
            step += CONTROL_STEPS
            way.append(vehicle.state)
    return way


def demand(setpoint: VelocitySetpoint, yaw: float) -> Demand:
    level = complex(setpoint.forward_m_s, setpoint.right_m_s) * cmath.rect(1.0, yaw)
    return Demand((level.real, level.imag, setpoint.down_m_s), setpoint.yaw_rate_rad_s)


@pytest.mark.slow
@pytest.mark.parametrize("firmware", [PX4, ARDUCOPTER], ids=["px4", "ardupilot"])
@FEW
@given(start=starts, manoeuvre=manoeuvres)
@example((-20.0, -35.0, math.pi / 2), [(VelocitySetpoint(10.0), 12.0)])
@example((-5.0, 0.0, 0.0), [(VelocitySetpoint(2.0, 7.0), 6.0), (VelocitySetpoint(-5.0, 2.0), 3.0)])
@example(
    (-39.0, -20.0, math.pi / 2),
    [(VelocitySetpoint(10, 0, 0, 0), 3), (VelocitySetpoint(10, 0, 0, 1.05), 4)],
)
def test_the_polygon_is_never_left(firmware, start, manoeuvre) -> None:
    fence = Fence(NOTCHED)
    for state in fly(firmware, start, manoeuvre):
        assert fence.contains(complex(*state.position_m[:2]))


@pytest.mark.parametrize("firmware", [PX4, ARDUCOPTER], ids=["px4", "ardupilot"])
@pytest.mark.parametrize("angle_deg", [25.0, 60.0])
def test_it_stops_in_a_sharp_corner(firmware, angle_deg: float) -> None:
    """Its sides are come near to slowly, however fast one flies at the corner itself."""
    half = 120.0 * math.tan(math.radians(angle_deg / 2))
    corners = ((0.0, 0.0), (-120.0, -half), (-120.0, half))
    limits = replace(SETTINGS, fence_m=corners)
    way = fly(firmware, (-80.0, 5.0, 0.0), [(VelocitySetpoint(10.0), 15.0)], limits)
    assert min(Fence(corners).distance_m(complex(*one.position_m[:2])) for one in way) > 2.0
    assert all(Fence(corners).contains(complex(*one.position_m[:2])) for one in way)


@pytest.mark.slow
@pytest.mark.parametrize("firmware", [PX4, ARDUCOPTER], ids=["px4", "ardupilot"])
@FEW
@given(start=starts, manoeuvre=manoeuvres)
def test_between_floor_and_ceiling_it_stays(firmware, start, manoeuvre) -> None:
    heights = [-state.position_m[2] for state in fly(firmware, start, manoeuvre)]
    assert min(heights) > SETTINGS.min_height_m - 0.3
    assert max(heights) < SETTINGS.ceiling_m + 0.3


@pytest.mark.slow
@pytest.mark.parametrize("firmware", [PX4, ARDUCOPTER], ids=["px4", "ardupilot"])
@pytest.mark.parametrize("speed", [2.0, 5.0, 8.0])
def test_however_fast_it_climbs_and_sinks_it_stops_in_time(firmware, speed: float) -> None:
    """ArduCopter brakes upwards and downwards with 1 m/s2 alone."""
    limits = replace(SETTINGS, fence_m=None, max_climb_m_s=speed, max_descent_m_s=speed)
    seconds = 47.0 / speed + 10.0
    manoeuvre = [(VelocitySetpoint(down_m_s=way), seconds) for way in (-speed, speed)]
    heights = [-state.position_m[2] for state in fly(firmware, (0.0, 0.0, 0.0), manoeuvre, limits)]
    assert limits.ceiling_m - 1.0 < max(heights) < limits.ceiling_m + 0.8
    assert limits.min_height_m - 0.8 < min(heights) < limits.min_height_m + 1.0


@pytest.mark.slow
@pytest.mark.parametrize("firmware", [PX4, ARDUCOPTER], ids=["px4", "ardupilot"])
@pytest.mark.parametrize("away", [3.0, 30.0])
def test_outside_it_comes_back_if_asked_and_otherwise_stays(firmware, away: float) -> None:
    """South of the polygon, nose to the north."""
    fence, start = Fence(NOTCHED), (-40.0 - away, 10.0, 0.0)
    back = fly(firmware, start, [(VelocitySetpoint(5.0), 14.0)])
    assert fence.contains(complex(*back[-1].position_m[:2]))
    distances = [fence.distance_m(complex(*s.position_m[:2])) for s in back]
    first_in = next(i for i, s in enumerate(back) if fence.contains(complex(*s.position_m[:2])))
    assert all(b < a + 0.01 for a, b in pairwise(distances[:first_in]))
    for way in (VelocitySetpoint(-5.0), VelocitySetpoint(0.0, 5.0)):
        end = fly(firmware, start, [(way, 6.0)])[-1].position_m
        assert math.dist(end[:2], start[:2]) < 0.5 or end[0] > start[0]


def approach(firmware, asked: VelocitySetpoint, start_m: float, height_m: float) -> list[float]:
    """Fly at a standing target ahead on the ground for 15 s; return the distances to it."""
    settings = EnvelopeSettings(
        fence_radius_m=None, min_distance_m=6.0, min_height_m=1.0, max_descent_m_s=5.0
    )
    body = BodyState(0.0, (0.0, 0.0, -height_m))
    vehicle, envelope = SimulatedVehicle(firmware.response, body), Envelope(settings)
    envelope.start(HOLD, 0.0)
    distances = []
    for step in range(0, 3000, CONTROL_STEPS):
        state = vehicle.state
        north, east, down = state.position_m
        range_m = math.hypot(start_m - north, east, down)
        distances.append(range_m)
        bearing = math.atan2(-east, start_m - north) - state.yaw_rad
        context = FlightContext(
            state.yaw_rad,
            *(north, east, -down),
            target_range_m=range_m,
            target_bearing_rad=bearing,
            target_elevation_rad=-math.asin(-down / range_m),
            north_m_s=state.velocity_m_s[0],
            east_m_s=state.velocity_m_s[1],
        )
        allowed = envelope.limit(asked, step * STEP_S, context).allowed
        for _ in range(CONTROL_STEPS):
            vehicle.step(demand(allowed, vehicle.state.yaw_rad))
    return distances


@pytest.mark.parametrize("firmware", [PX4, ARDUCOPTER], ids=["px4", "ardupilot"])
@pytest.mark.parametrize(
    ("asked", "start_m", "height_m"),
    [
        (VelocitySetpoint(10.0), 60.0, 3.0),
        (VelocitySetpoint(10.0, 0.0, 1.5), 40.0, 20.0),
        (VelocitySetpoint(0.0, 0.0, 1.5), 0.5, 25.0),
        (VelocitySetpoint(0.0, 0.0, 5.0), 0.5, 40.0),
        (VelocitySetpoint(3.0, 3.0, 1.0, 0.3), 20.0, 8.0),
    ],
    ids=["level", "down a slope", "from above", "fast from above", "turning"],
)
def test_it_stops_before_a_target(firmware, asked, start_m: float, height_m: float) -> None:
    assert min(approach(firmware, asked, start_m, height_m)) > 6.0 - 0.7


@pytest.mark.slow
@pytest.mark.parametrize("firmware", [PX4, ARDUCOPTER], ids=["px4", "ardupilot"])
@pytest.mark.parametrize("speed", [3.0, 6.0, 10.0])
def test_from_any_speed_it_stops_within_the_radius(firmware, speed: float) -> None:
    settings = EnvelopeSettings(fence_radius_m=60.0, min_distance_m=None)
    start = (-50.0, 0.0, 0.0)
    way = fly(firmware, start, [(VelocitySetpoint(speed), 50.0)], settings)
    farthest = max(math.hypot(*state.position_m[:2]) for state in way)
    assert 55.0 < farthest < 60.0


@pytest.mark.parametrize("firmware", [PX4, ARDUCOPTER], ids=["px4", "ardupilot"])
@pytest.mark.parametrize("start", [(-8.0, 1.0, 0.0), (0.0, 0.0, 0.0), (3.0, -7.0, 2.0)])
def test_across_a_small_circle_it_flies_no_faster_than_it_can_stop(firmware, start) -> None:
    """Beside its middle the nearest way out is to the side, and the one ahead is the short one."""
    settings = EnvelopeSettings(fence_radius_m=14.0, min_distance_m=None)
    for asked in (VelocitySetpoint(10.0), VelocitySetpoint(6.0, -7.0)):
        way = fly(firmware, start, [(asked, 8.0)], settings)
        assert 10.0 < max(math.hypot(*state.position_m[:2]) for state in way) < 14.0
