"""Each limit of the envelope, with its name, and the vehicle that stops in time."""

import math
from collections import deque
from dataclasses import replace

import hypothesis.strategies as st
import pytest
from hypothesis import given

from follower_control.envelope.envelope import Envelope
from follower_control.envelope.flight_context import FlightContext
from follower_control.envelope.jerk_limiter import Limit, VelocityBound
from follower_control.envelope.settings import EnvelopeSettings
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState

DT = 0.02
FREE = FlightContext(
    yaw_rad=0.0,
    north_m=0.0,
    east_m=0.0,
    height_m=20.0,
    target_range_m=100.0,
    target_bearing_rad=0.0,
)
SETTINGS = EnvelopeSettings()
PAST = 0.4
"""How far a vehicle with 0.2 s dead time and 0.5 s lag may run past a limit, metres."""


def settled(asked: VelocitySetpoint, context: FlightContext = FREE, settings=SETTINGS):
    """Ask for the same until the envelope has come to rest."""
    envelope = Envelope(settings)
    envelope.start(HOLD, 0.0)
    for i in range(1, 600):
        limited = envelope.limit(asked, i * DT, context)
    return limited


def test_what_is_within_limits_passes_unchanged_and_unnamed():
    asked = VelocitySetpoint(3.0, -2.0, 0.5, 0.4)
    limited = settled(asked)
    assert limited.allowed.values == pytest.approx(asked.values, abs=1e-9)
    assert limited.limits == ()
    assert limited.asked is asked


@pytest.mark.parametrize(
    ("asked", "allowed", "limit"),
    [
        (VelocitySetpoint(30.0, 40.0), VelocitySetpoint(6.0, 8.0), Limit.SPEED),
        (VelocitySetpoint(down_m_s=-9.0), VelocitySetpoint(down_m_s=-2.0), Limit.CLIMB),
        (VelocitySetpoint(down_m_s=9.0), VelocitySetpoint(down_m_s=1.5), Limit.DESCENT),
        (
            VelocitySetpoint(yaw_rate_rad_s=-5.0),
            VelocitySetpoint(yaw_rate_rad_s=-math.radians(60)),
            Limit.YAW_RATE,
        ),
    ],
)
def test_bounds(asked, allowed, limit):
    limited = settled(asked)
    assert limited.allowed.values == pytest.approx(allowed.values, abs=1e-6)
    assert limited.limits == (limit,)


def test_without_a_limit_on_yaw_jerk_the_yaw_rate_changes_by_the_acceleration_at_once():
    envelope = Envelope(EnvelopeSettings(max_yaw_acceleration_deg_s2=90, max_yaw_jerk_deg_s3=None))
    envelope.start(HOLD, 0.0)
    limited = envelope.limit(VelocitySetpoint(yaw_rate_rad_s=1.0), DT, FREE)
    assert limited.allowed.yaw_rate_rad_s == math.radians(90) * DT
    assert limited.limits == (Limit.YAW_ACCELERATION,)


def test_with_one_the_yaw_acceleration_grows_by_it():
    envelope = Envelope(EnvelopeSettings(max_yaw_jerk_deg_s3=500.0))
    envelope.start(HOLD, 0.0)
    asked = VelocitySetpoint(yaw_rate_rad_s=1.0)
    turns = [envelope.limit(asked, i * DT, FREE).allowed.yaw_rate_rad_s for i in (1, 2)]
    growth = math.radians(500.0) * DT**2
    assert turns == pytest.approx([growth, 3 * growth])


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("field", ["forward_m_s", "right_m_s", "down_m_s", "yaw_rate_rad_s"])
def test_one_number_that_is_not_finite_makes_it_slow_down_to_a_hold(field, bad):
    envelope = Envelope(SETTINGS)
    envelope.start(VelocitySetpoint(5.0, 1.0, 1.0, 0.5), 0.0)
    asked = replace(VelocitySetpoint(5.0, 1.0, 1.0, 0.5), **{field: bad})
    first = envelope.limit(asked, DT, FREE)
    assert Limit.NOT_FINITE in first.limits
    assert 4.5 < first.allowed.forward_m_s < 5.0
    for i in range(2, 400):
        last = envelope.limit(asked, i * DT, FREE)
    assert last.allowed.values == pytest.approx((0, 0, 0, 0), abs=1e-9)


def test_the_start_continues_from_the_present_velocity():
    envelope = Envelope(SETTINGS)
    present = VelocitySetpoint(4.0, 1.0, -0.5, 0.3)
    envelope.start(present, 10.0)
    assert envelope.limit(present, 10.02, FREE).allowed.values == pytest.approx(present.values)


def test_a_start_beyond_the_bounds_is_cut_to_them_and_one_not_finite_stands():
    envelope = Envelope(SETTINGS)
    envelope.start(VelocitySetpoint(1e300, 1e300, 50.0, -9.0), 0.0)
    allowed = envelope.limit(HOLD, 0.0, FREE).allowed
    assert math.hypot(allowed.forward_m_s, allowed.right_m_s) == pytest.approx(10.0)
    assert (allowed.down_m_s, allowed.yaw_rate_rad_s) == pytest.approx((1.5, -math.radians(60)))
    envelope.start(VelocitySetpoint(math.nan), 0.0)
    assert envelope.limit(HOLD, 0.0, FREE).allowed == HOLD


def test_the_first_call_without_a_start_holds():
    assert Envelope().limit(VelocitySetpoint(5.0), 123.0, FREE).allowed == HOLD


@pytest.mark.parametrize("start_s", [math.nan, math.inf])
def test_a_start_at_no_time_waits_for_the_first_call(start_s):
    envelope = Envelope(SETTINGS)
    envelope.start(HOLD, start_s)
    assert envelope.limit(VelocitySetpoint(5.0), 7.0, FREE).allowed == HOLD
    assert envelope.limit(VelocitySetpoint(5.0), 7.1, FREE).allowed.forward_m_s > 0


def test_a_hold_needs_to_know_nothing_and_stops():
    envelope = Envelope(SETTINGS)
    envelope.start(VelocitySetpoint(8.0, 0.0, 1.0, 1.0), 0.0)
    speeds = [
        envelope.limit(HOLD, i * DT, FlightContext()).allowed.forward_m_s for i in range(1, 200)
    ]
    assert speeds == sorted(speeds, reverse=True)
    assert speeds[-1] == pytest.approx(0.0, abs=1e-9)


def test_a_long_pause_counts_as_a_short_one():
    envelope = Envelope(SETTINGS)
    envelope.start(HOLD, 0.0)
    after = envelope.limit(VelocitySetpoint(8.0), 60.0, FREE).allowed.forward_m_s
    longest = SETTINGS.max_interval_s
    assert 0 < after <= SETTINGS.max_jerk_m_s3 * longest**2 + 1e-9


def test_moments_too_short_to_count_add_up():
    envelope = Envelope(SETTINGS)
    envelope.start(HOLD, 0.0)
    for i in range(1, 100):
        assert envelope.limit(VelocitySetpoint(5.0), i * 1e-8, FREE).allowed == HOLD
    assert envelope.limit(VelocitySetpoint(5.0), 1e-5, FREE).allowed.forward_m_s > 0


def test_time_running_backwards_changes_nothing_and_then_goes_on():
    envelope = Envelope(SETTINGS)
    envelope.start(VelocitySetpoint(2.0), 100.0)
    assert envelope.limit(VelocitySetpoint(8.0), 50.0, FREE).allowed == VelocitySetpoint(2.0)
    assert envelope.limit(VelocitySetpoint(8.0), 50.02, FREE).allowed.forward_m_s > 2.0


@pytest.mark.parametrize(
    ("unknown", "asked", "allowed", "limit"),
    [
        ("height_m", (2, 1, 1, 0.1), (2, 1, 0, 0.1), Limit.HEIGHT_UNKNOWN),
        ("height_m", (2, 1, -1, 0.1), (2, 1, 0, 0.1), Limit.HEIGHT_UNKNOWN),
        ("north_m", (2, 1, 1, 0.1), (0, 0, 1, 0.1), Limit.POSITION_UNKNOWN),
        ("yaw_rad", (-2, 1, 1, 0.1), (0, 0, 1, 0.1), Limit.POSITION_UNKNOWN),
        ("target_range_m", (2, 1, 1, 0.1), (0, 1, 1, 0.1), Limit.RANGE_UNKNOWN),
        ("target_bearing_rad", (-2, 1, 1, 0.1), (-2, 1, 1, 0.1), None),
    ],
)
@pytest.mark.parametrize("value", [None, math.nan, math.inf])
def test_the_unknown_is_taken_for_the_worst(unknown, asked, allowed, limit, value):
    limited = settled(VelocitySetpoint(*asked), replace(FREE, **{unknown: value}))
    assert limited.allowed.values == pytest.approx(allowed, abs=1e-6)
    assert limited.limits == (() if limit is None else (limit,))


def test_limits_that_are_switched_off_need_no_telemetry():
    bare = EnvelopeSettings(
        min_height_m=None, ceiling_m=None, fence_radius_m=None, min_distance_m=None
    )
    asked = VelocitySetpoint(5.0, 1.0, 1.0, 0.1)
    limited = settled(asked, FlightContext(), bare)
    assert limited.allowed.values == pytest.approx(asked.values, abs=1e-9)
    assert limited.limits == ()


@pytest.mark.parametrize(
    ("context", "asked", "allowed", "limit"),
    [
        (replace(FREE, height_m=2.0), (0, 0, 1, 0), (0, 0, 0, 0), Limit.MIN_HEIGHT),
        (replace(FREE, height_m=2.0), (0, 0, -1, 0), (0, 0, -1, 0), None),
        (replace(FREE, height_m=60.0), (0, 0, -1, 0), (0, 0, 0, 0), Limit.CEILING),
        (replace(FREE, height_m=60.0), (0, 0, 1, 0), (0, 0, 1, 0), None),
        (replace(FREE, north_m=250.0), (3, 2, 0, 0), (0, 2, 0, 0), Limit.FENCE),
        (replace(FREE, north_m=250.0), (-3, 2, 0, 0), (-3, 2, 0, 0), None),
        (replace(FREE, east_m=250.0, yaw_rad=math.pi / 2), (3, 2, 0, 0), (0, 2, 0, 0), Limit.FENCE),
        (replace(FREE, target_range_m=3.0), (3, 2, 0, 0), (0, 2, 0, 0), Limit.TARGET_NEAR),
        (replace(FREE, target_range_m=3.0), (-3, 2, 0, 0), (-3, 2, 0, 0), None),
        (
            replace(FREE, target_range_m=3.0, target_bearing_rad=math.pi / 2),
            (3, 2, 0, 0),
            (3, 0, 0, 0),
            Limit.TARGET_NEAR,
        ),
    ],
)
def test_beyond_a_limit_only_the_way_back_is_free(context, asked, allowed, limit):
    limited = settled(VelocitySetpoint(*asked), context)
    assert limited.allowed.values == pytest.approx(allowed, abs=1e-6)
    assert limited.limits == (() if limit is None else (limit,))


angles = st.floats(-math.pi, math.pi)


@pytest.mark.slow
@given(angles, angles, angles, angles)
def test_fence_and_target_together_never_let_more_through_than_either(yaw, place, bearing, way):
    """Outside the fence and next to the target, nothing leads farther out or nearer."""
    context = FlightContext(
        yaw_rad=yaw,
        north_m=300 * math.cos(place),
        east_m=300 * math.sin(place),
        height_m=20.0,
        target_range_m=1.0,
        target_bearing_rad=bearing,
    )
    asked = VelocitySetpoint(5 * math.cos(way), 5 * math.sin(way))
    allowed = settled(asked, context).allowed
    outward, near = place - yaw, bearing
    for direction in (outward, near):
        speed = allowed.forward_m_s * math.cos(direction) + allowed.right_m_s * math.sin(direction)
        assert speed <= 1e-6


def heights_flown(asked: VelocitySetpoint, lag_s=0.5, dead_s=0.2) -> list[float]:
    """Fly a sluggish vehicle down or up by what the envelope allows; return its heights."""
    envelope, height, climb, heights = Envelope(SETTINGS), 30.0, 0.0, []
    envelope.start(HOLD, 0.0)
    delayed = deque([HOLD] * round(dead_s / DT))
    for i in range(1, 5000):
        context = replace(FREE, height_m=height)
        delayed.append(envelope.limit(asked, i * DT, context).allowed)
        climb += (-delayed.popleft().down_m_s - climb) * DT / lag_s
        height += climb * DT
        heights.append(height)
    return heights


@pytest.mark.parametrize(
    ("down_m_s", "extreme", "limit_m"),
    [(1.5, min, SETTINGS.min_height_m), (-2.0, max, SETTINGS.ceiling_m)],
)
def test_at_full_descent_or_climb_the_vehicle_stops_at_the_limit(down_m_s, extreme, limit_m):
    heights = heights_flown(VelocitySetpoint(down_m_s=down_m_s))
    assert limit_m - PAST <= extreme(heights) <= limit_m + PAST


def test_a_target_that_moves_away_may_be_followed_at_its_speed():
    context = replace(FREE, target_range_m=15.0, target_speed_m_s=8.0)
    assert settled(VelocitySetpoint(8.0), context).allowed.forward_m_s == pytest.approx(8.0)
    standing = settled(VelocitySetpoint(8.0), replace(context, target_speed_m_s=None))
    assert standing.allowed.forward_m_s < 6.0
    towards_us = settled(VelocitySetpoint(8.0), replace(context, target_speed_m_s=-8.0))
    assert towards_us.allowed == standing.allowed


def test_a_bound_reports_what_it_takes_away():
    bound = VelocityBound.towards(0.0, 1.0, Limit.FENCE)
    assert bound.excess(3 + 2j) == pytest.approx(2.0)
    assert bound.kept(3 + 2j) == pytest.approx(1 + 2j)
    assert bound.share(3 + 2j) == pytest.approx(1 / 3)
    assert bound.share(0.5 - 7j) == 1.0


def test_the_context_takes_what_is_fresh_of_the_vehicle():
    state = VehicleState(
        attitude=Attitude(0, 0, 1.0, 0, 0, 0, 10.0),
        position=LocalPosition(1.0, 2.0, -3.0, 0, 0, 0, 9.5),
    )
    standing = {"north_m_s": 0, "east_m_s": 0}
    known = FlightContext(1.0, 1.0, 2.0, 3.0, **standing)
    assert FlightContext.of(state, 9.7) == known
    motion_forgotten = replace(known, north_m_s=None, east_m_s=None)
    assert FlightContext.of(state, 10.2) == motion_forgotten
    assert FlightContext.of(state, 10.8) == FlightContext(yaw_rad=1.0)
    assert FlightContext.of(VehicleState(), 0.0) == FlightContext()


def test_on_the_ground_a_hold_is_zero_whatever_velocity_the_estimator_believes_in():
    noisy = VehicleState(
        attitude=Attitude(0, 0, 0.0, 0, 0, 0, 10.0),
        position=LocalPosition(0, 0, 0, 0.3, -0.2, 0.1, 10.0),
    )

    def held(landed: bool) -> VelocitySetpoint:
        envelope, context = Envelope(), FlightContext.of(replace(noisy, landed=landed), 10.0)
        return [envelope.limit(HOLD, i * DT, context).allowed for i in range(50)][-1]

    assert held(landed=True) == HOLD
    assert held(landed=False).forward_m_s < -0.3  # how far the target is is not known
