"""The envelope's limits that come from the world: ground, target below, doubt, polygon."""

import cmath
import math
from dataclasses import replace

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import settings as hypothesis_settings

from follower_control.envelope.envelope import Envelope
from follower_control.envelope.flight_context import FlightContext
from follower_control.envelope.jerk_limiter import Limit
from follower_control.envelope.settings import EnvelopeSettings
from follower_control.target.estimate import TargetEstimate
from follower_control.target.estimator import trust_in
from follower_control.target.observation import BearingFrame
from follower_control.target.settings import TrustSettings
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_control.vehicle.state import Attitude, Clearance, LocalPosition, Origin, VehicleState

FREE = EnvelopeSettings(
    min_height_m=None,
    ceiling_m=None,
    fence_radius_m=None,
    min_distance_m=None,
    min_clearance_m=None,
)
SQUARE = ((-50.0, -50.0), (-50.0, 50.0), (50.0, 50.0), (50.0, -50.0))


def settled(settings: EnvelopeSettings, asked: VelocitySetpoint, context: FlightContext):
    """Insist for ten seconds; return the last answer."""
    envelope = Envelope(settings)
    envelope.start(now_s=0.0)
    return [envelope.limit(asked, 0.02 * i, context) for i in range(500)][-1]


def test_above_ground_that_is_measured_it_sinks_no_further() -> None:
    settings, sink = replace(FREE, min_clearance_m=2.0), VelocitySetpoint(down_m_s=1.5)
    low = settled(settings, sink, FlightContext(clearance_m=1.9))
    assert low.allowed.down_m_s == pytest.approx(0.0, abs=1e-6)
    assert Limit.MIN_CLEARANCE in low.limits
    assert settled(settings, sink, FlightContext(clearance_m=30.0)).allowed.down_m_s > 1.4
    assert settled(settings, sink, FlightContext()).allowed.down_m_s > 1.4
    climb = settled(settings, VelocitySetpoint(down_m_s=-1.0), FlightContext(clearance_m=0.5))
    assert climb.allowed.down_m_s == pytest.approx(-1.0)


def above(elevation_deg: float, range_m: float) -> FlightContext:
    return FlightContext(
        target_range_m=range_m,
        target_bearing_rad=0.0,
        target_elevation_rad=math.radians(elevation_deg),
    )


def test_onto_a_target_below_it_does_not_sink() -> None:
    settings, sink = replace(FREE, min_distance_m=5.0), VelocitySetpoint(down_m_s=1.5)
    near = settled(settings, sink, above(-90, 5.0))
    assert near.allowed.down_m_s == pytest.approx(0.0, abs=1e-6)
    assert Limit.TARGET_NEAR in near.limits
    assert settled(settings, sink, above(-90, 40.0)).allowed.down_m_s > 1.4
    beside = settled(settings, sink, above(0, 5.0))
    assert beside.allowed.down_m_s == pytest.approx(1.5)


def rushing(speed_m_s: float, **known: float) -> FlightContext:
    """Towards a target that is 6 m ahead and below, with a place, a heading and a height."""
    context = replace(
        above(-20, 6.0), yaw_rad=0.0, north_m_s=speed_m_s, east_m_s=0.0, height_m=10.0
    )
    return replace(context, **known)


def test_over_a_target_that_it_cannot_stop_before_it_climbs() -> None:
    settings = replace(FREE, min_distance_m=4.0)
    limited = settled(settings, VelocitySetpoint(4.0, 0.0, 1.0, 0.0), rushing(5.0))
    assert limited.allowed.down_m_s == pytest.approx(-settings.max_climb_m_s)
    assert Limit.TARGET_NEAR in limited.limits
    low = settled(replace(settings, ceiling_m=10.0), HOLD, rushing(5.0))
    assert low.allowed.down_m_s == pytest.approx(0.0, abs=1e-6), "not above the ceiling"
    unknown = replace(rushing(5.0), height_m=None)
    low = settled(replace(settings, ceiling_m=10.0), HOLD, unknown)
    assert low.allowed.down_m_s == pytest.approx(0.0, abs=1e-6), "nor where the height is unknown"


@pytest.mark.parametrize(
    "context",
    [
        rushing(0.3),
        rushing(5.0, target_range_m=14.0),
        rushing(5.0, target_speed_m_s=5.0, target_range_m=8.0),
        rushing(-5.0),
        rushing(5.0, target_bearing_rad=math.pi / 2),
        rushing(5.0, target_elevation_rad=math.radians(20)),
        replace(rushing(5.0), north_m_s=None),
    ],
)
def test_otherwise_it_keeps_its_height_before_a_target(context: FlightContext) -> None:
    settings = replace(FREE, min_distance_m=4.0)
    assert settled(settings, HOLD, context).allowed.down_m_s == pytest.approx(0.0, abs=1e-6)


def test_above_a_target_it_may_go_where_it_likes() -> None:
    settings, ahead = replace(FREE, min_distance_m=5.0), VelocitySetpoint(6.0)
    assert settled(settings, ahead, above(-90, 8.0)).allowed.forward_m_s == pytest.approx(6.0)
    level = settled(settings, ahead, above(0, 8.0)).allowed.forward_m_s
    assert settled(settings, ahead, above(-40, 8.0)).allowed.forward_m_s == pytest.approx(level)
    assert level < 2.0


def test_where_it_would_come_too_near_climbing_and_going_ahead_stay_allowed_away_from_it() -> None:
    settings = replace(FREE, min_distance_m=5.0)
    away = settled(settings, VelocitySetpoint(-2.0, 0.0, -1.0), above(-45, 3.0)).allowed
    assert away.forward_m_s == pytest.approx(-2.0)
    assert away.down_m_s == pytest.approx(-1.0)


@pytest.mark.parametrize(("trust", "most"), [(1.0, 8.0), (0.5, 5.0), (0.0, 0.0), (None, 8.0)])
def test_the_largest_speed_falls_with_trust(trust: float | None, most: float) -> None:
    limited = settled(FREE, VelocitySetpoint(8.0), FlightContext(trust=trust))
    assert limited.allowed.forward_m_s == pytest.approx(most, abs=1e-6)
    assert (Limit.DOUBT in limited.limits) == (most < 8.0)


def estimate(deviation_deg: float, age_s: float) -> TargetEstimate:
    covariance = np.eye(6) * math.radians(deviation_deg) ** 2
    return TargetEstimate(
        10.0, 0.0, 0.0, -2.0, 0.0, 0.0, 0.0, covariance, 10.0 - age_s, BearingFrame.WORLD
    )


@given(st.tuples(st.floats(0, 20), st.floats(0, 20)), st.tuples(st.floats(0, 5), st.floats(0, 5)))
def test_more_doubt_is_never_more_trust(deviations, ages) -> None:
    settings = TrustSettings()
    more = trust_in(estimate(min(deviations), min(ages)), settings)
    less = trust_in(estimate(max(deviations), max(ages)), settings)
    assert 0 <= less <= more <= 1


def test_a_fresh_sure_estimate_is_trusted_and_one_without_a_finite_covariance_is_not() -> None:
    assert trust_in(estimate(1.0, 0.1), TrustSettings()) == 1.0
    assert trust_in(estimate(9.0, 0.1), TrustSettings()) == 0.0
    assert trust_in(estimate(1.0, 2.5), TrustSettings()) == 0.0
    unknown = replace(estimate(1.0, 0.1), covariance=np.full((6, 6), math.nan))
    assert trust_in(unknown, TrustSettings()) == 0.0


def test_towards_a_side_it_slows_down_and_along_it_it_does_not() -> None:
    settings = replace(FREE, fence_m=SQUARE)
    near = FlightContext(yaw_rad=0.0, north_m=46.0, east_m=0.0)
    out = settled(settings, VelocitySetpoint(8.0), near)
    assert 0.0 < out.allowed.forward_m_s < 1.0
    assert Limit.FENCE in out.limits
    along = settled(settings, VelocitySetpoint(0.0, 6.0), near).allowed
    assert along.right_m_s == pytest.approx(6.0)
    east = settled(settings, VelocitySetpoint(8.0), replace(near, yaw_rad=math.pi / 2)).allowed
    assert east.forward_m_s == pytest.approx(8.0)


def test_while_the_nose_turns_towards_a_side_the_velocity_is_taken_back_in_time() -> None:
    settings = replace(FREE, fence_m=SQUARE)
    along = FlightContext(yaw_rad=math.pi / 2, north_m=46.0, east_m=0.0)
    turning = settled(settings, VelocitySetpoint(8.0, 0.0, 0.0, -1.0), along).allowed
    soon = complex(turning.forward_m_s, turning.right_m_s) * cmath.rect(1.0, math.pi / 2 - 1.0)
    assert soon.real < 1.0
    away = settled(settings, VelocitySetpoint(8.0, 0.0, 0.0, 1.0), along).allowed
    assert away.forward_m_s == pytest.approx(8.0)


@pytest.mark.parametrize(
    "context",
    [
        FlightContext(),
        FlightContext(yaw_rad=0.0),
        FlightContext(north_m=0.0, east_m=0.0),
        FlightContext(yaw_rad=math.nan, north_m=0.0, east_m=0.0),
    ],
)
def test_without_a_place_there_is_no_way(context: FlightContext) -> None:
    limited = settled(replace(FREE, fence_m=SQUARE), VelocitySetpoint(3.0, 2.0), context)
    assert abs(limited.allowed.forward_m_s) + abs(limited.allowed.right_m_s) < 1e-6
    assert Limit.POSITION_UNKNOWN in limited.limits


def test_a_fence_in_degrees_needs_home_and_then_counts_in_metres() -> None:
    side = 50.0 / 111_194.9
    corners = ((-side, -side), (-side, side), (side, side), (side, -side))
    settings = replace(FREE, fence_deg=corners)
    place = FlightContext(yaw_rad=0.0, north_m=46.0, east_m=0.0)
    unknown = settled(settings, VelocitySetpoint(8.0), place)
    assert Limit.POSITION_UNKNOWN in unknown.limits
    known = settled(settings, VelocitySetpoint(8.0), replace(place, home_deg=(0.0, 0.0)))
    same = settled(replace(FREE, fence_m=SQUARE), VelocitySetpoint(8.0), place)
    assert known.allowed.forward_m_s == pytest.approx(same.allowed.forward_m_s, abs=0.01)


@pytest.mark.parametrize("corner", [(95.0, 8.0), (151.2, -33.8), (-33.8, 400.0)])
def test_a_corner_that_is_nowhere_on_earth_is_refused(corner: tuple[float, float]) -> None:
    """Latitude and longitude exchanged would be a fence far away, and so none."""
    with pytest.raises(ValueError, match="latitude, longitude"):
        replace(FREE, fence_deg=(corner, (-33.8, 151.3), (-33.9, 151.2)))


def test_outside_is_told_by_circle_and_polygon() -> None:
    fences = replace(FREE, fence_radius_m=60.0), replace(FREE, fence_m=SQUARE)
    for settings in fences:
        for north, outside in ((0.0, False), (70.0, True)):
            context = FlightContext(north_m=north, east_m=0.0)
            assert Envelope(settings).is_outside(context) is outside
        assert not Envelope(settings).is_outside(FlightContext())


def test_the_context_takes_clearance_while_it_is_fresh() -> None:
    state = VehicleState(clearance=Clearance(7.0, 10.0))
    assert FlightContext.of(state, 10.5).clearance_m == 7.0
    assert FlightContext.of(state, 11.5).clearance_m is None


@given(st.floats(-80, 80), st.floats(-180, 180), st.floats(-2e3, 2e3), st.floats(-2e3, 2e3))
@example(0.0, 179.9995, 0.0, 100.0)
def test_places_of_the_map_go_there_and_back_across_the_180th_meridian(
    latitude: float, longitude: float, north: float, east: float
) -> None:
    origin = Origin(latitude, longitude)
    place = origin.geolocated(north, east)
    assert -180 <= place[1] <= 180
    assert origin.local(*place) == pytest.approx((north, east), abs=1e-3)


def test_height_circle_and_fence_count_from_home_wherever_positions_do() -> None:
    """An autopilot counts positions from where it was switched on, also on its second flight."""
    place = LocalPosition(10.0, 310.0, -19.0, 0.0, 0.0, 0.0, 10.0, home_m=(0.0, 300.0, -15.0))
    context = FlightContext.of(VehicleState(position=place, origin=Origin(0.0, 8.0)), 10.0)
    assert (context.north_m, context.east_m, context.height_m) == (10.0, 10.0, 4.0)
    assert context.home_deg == pytest.approx((0.0, 8.0 + 300.0 / 111_194.9))


def test_at_a_fence_it_is_not_driven_back_by_a_velocity_of_some_time_ago() -> None:
    settings = replace(FREE, fence_radius_m=50.0)
    outwards = VehicleState(
        attitude=Attitude(0, 0, 0, 0, 0, 0, 10.0),
        position=LocalPosition(49.0, 0.0, -10.0, 1.0, 0.0, 0.0, 10.0),
    )

    def forward_m_s(age_s: float, after_s: float) -> float:
        context, envelope = FlightContext.of(outwards, 10.0 + age_s), Envelope(settings)
        envelope.start(now_s=0.0)
        times = (0.02 * i for i in range(round(after_s / 0.02)))
        return [envelope.limit(HOLD, at_s, context) for at_s in times][-1].allowed.forward_m_s

    assert forward_m_s(0.1, after_s=2.5) < -1.0
    assert forward_m_s(0.4, after_s=2.5) == pytest.approx(0.0, abs=1e-6)
    # Nor by one that no braking changes: its heading may not be true.
    assert forward_m_s(0.1, after_s=8.0) == pytest.approx(0.0, abs=1e-6)


anything = st.one_of(st.none(), st.floats(-100, 100), st.floats(allow_nan=True))
wild = st.builds(VelocitySetpoint, *[st.floats(allow_nan=True)] * 4)


@hypothesis_settings(max_examples=60)
@given(asked=wild, values=st.lists(anything, min_size=12, max_size=12))
def test_whatever_is_known_what_leaves_is_finite_and_within_speed(asked, values) -> None:
    settings = EnvelopeSettings(fence_m=SQUARE)
    names = [
        *("yaw_rad", "north_m", "east_m", "height_m", "target_range_m", "target_bearing_rad"),
        *("target_speed_m_s", "target_elevation_rad", "clearance_m", "north_m_s", "east_m_s"),
        "trust",
    ]
    context = FlightContext(**dict(zip(names, values, strict=True)))
    envelope = Envelope(settings)
    envelope.start(now_s=0.0)
    for i in range(60):
        allowed = envelope.limit(asked, 0.02 * i, context).allowed
        assert allowed.is_finite
        assert math.hypot(allowed.forward_m_s, allowed.right_m_s) <= settings.max_speed_m_s + 1e-6
        assert -settings.max_climb_m_s - 1e-6 <= allowed.down_m_s
        assert allowed.down_m_s <= settings.max_descent_m_s + 1e-6


@pytest.mark.slow
@hypothesis_settings(max_examples=40)
@given(speeds=st.lists(st.floats(-8, 8), min_size=2, max_size=30), begins=st.floats(0.5, 8))
def test_nothing_is_left_over_from_the_engagement_before(
    speeds: list[float], begins: float
) -> None:
    """Whatever went before: from a beginning on an envelope answers as a new one does."""
    settings = EnvelopeSettings(fence_radius_m=50)
    used, new = Envelope(settings), Envelope(settings)

    def outside(speed: float) -> FlightContext:
        place = {"north_m": 52.0, "east_m": 0.0, "height_m": 10.0}
        return FlightContext(yaw_rad=0.0, north_m_s=speed, east_m_s=0.0, **place)

    for step, speed in enumerate(speeds):
        used.limit(VelocitySetpoint(forward_m_s=speed), 0.02 * step, outside(abs(speed)))
    for one in (used, new):
        one.start(VelocitySetpoint(forward_m_s=begins), 10.0)
    for step in range(1, 150):
        now_s, context = 10.0 + 0.02 * step, outside(begins)
        assert used.limit(HOLD, now_s, context) == new.limit(HOLD, now_s, context)
