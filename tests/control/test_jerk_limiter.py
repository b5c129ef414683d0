"""A jerk-limited velocity: bounds, limits, no overshoot, and close to the fastest way there."""

import math

import hypothesis.strategies as st
import pytest
from hypothesis import example, given

from follower_control.envelope.jerk_limiter import JerkLimit

TOP, ACCELERATION, JERK = 8.0, 3.0, 10.0
inside = st.builds(
    lambda size, angle: size * complex(math.cos(angle), math.sin(angle)),
    st.floats(0, TOP),
    st.floats(-math.pi, math.pi),
)
intervals = st.floats(1e-4, 0.1)


def in_disc(velocity: complex) -> bool:
    return abs(velocity) <= TOP + 1e-9


def limiter(velocity: complex = 0.0) -> JerkLimit:
    limit = JerkLimit(ACCELERATION, JERK, in_disc)
    limit.start(velocity)
    return limit


def fastest_s(distance: float) -> float:
    """Rest to rest with limited first and second derivative: the textbook's S-curve."""
    if distance >= ACCELERATION**2 / JERK:
        return distance / ACCELERATION + ACCELERATION / JERK
    return 2 * math.sqrt(distance / JERK)


@given(inside, inside, intervals)
def test_from_steady_it_goes_straight_to_the_wanted_velocity_without_passing_it(start, end, dt):
    limit = limiter(start)
    left = abs(end - start)
    for _ in range(50):
        velocity = limit.step(end, dt)
        gone = abs(velocity - start)
        assert gone <= abs(end - start) + 1e-9
        assert gone + abs(end - velocity) == pytest.approx(abs(end - start), abs=1e-6)
        assert abs(end - velocity) <= left + 1e-9
        left = abs(end - velocity)


@given(inside, inside)
def test_it_arrives_nearly_as_fast_as_the_limits_allow(start, end):
    limit, dt, time = limiter(start), 0.02, 0.0
    while abs(limit.velocity - end) > 0.01 * TOP and time < 60:
        limit.step(end, dt)
        time += dt
    assert time <= fastest_s(abs(end - start)) + 2 * dt


@given(inside, st.lists(st.tuples(inside, intervals), max_size=100))
@example(8 + 0j, [(8j, 0.02)] * 60 + [(8 + 0j, 0.1)] * 40)
def test_bounds_and_limits_hold_for_any_wishes_and_intervals(start, wishes):
    limit = limiter(start)
    before, acceleration = limit.velocity, 0.0
    for wanted, dt in wishes:
        velocity = limit.step(wanted, dt)
        now = (velocity - before) / dt
        assert abs(velocity) <= TOP + 1e-6
        assert abs(now) <= ACCELERATION + 1e-6
        assert abs(now - acceleration) <= JERK * dt + 1e-6
        before, acceleration = velocity, now


def test_a_wish_withdrawn_at_full_acceleration_still_stays_within_the_disc():
    limit = limiter()
    for _ in range(140):  # still accelerating along the rim's normal, close to the rim
        limit.step(TOP, 0.02)
    for _ in range(250):
        assert abs(limit.step(TOP * 1j, 0.02)) <= TOP + 1e-6
    assert limit.velocity == pytest.approx(TOP * 1j, abs=0.01)


@pytest.mark.parametrize("dt", [0.0, -1.0])
def test_no_time_no_change(dt):
    limit = limiter(3.0)
    limit.step(0.0, 0.05)
    before = limit.velocity, limit.acceleration
    limit.step(8.0, dt)
    assert (limit.velocity, limit.acceleration) == before


def test_a_start_outside_is_scaled_to_the_rim():
    assert limiter(30 + 40j).velocity == pytest.approx(complex(0.6 * TOP, 0.8 * TOP), abs=1e-6)
