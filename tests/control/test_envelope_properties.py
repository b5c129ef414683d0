"""Whatever is asked, whenever, wherever: what leaves the envelope is within its limits."""

import math
from dataclasses import replace

import hypothesis.strategies as st
import pytest
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from follower_control.envelope.envelope import SHORTEST_S, Envelope
from follower_control.envelope.flight_context import FlightContext
from follower_control.envelope.settings import EnvelopeSettings
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint

SETTINGS = EnvelopeSettings(
    max_speed_m_s=6.0,
    max_climb_m_s=2.0,
    max_descent_m_s=1.0,
    max_acceleration_m_s2=2.5,
    max_jerk_m_s3=8.0,
    max_yaw_acceleration_deg_s2=90.0,
    max_yaw_jerk_deg_s3=400.0,
    fence_radius_m=50.0,
)
ROUNDING = 1e-6
MAX_YAW_RATE = math.radians(SETTINGS.max_yaw_rate_deg_s)
LIMITS = (
    (SETTINGS.max_acceleration_m_s2, SETTINGS.max_jerk_m_s3),
    (SETTINGS.max_acceleration_m_s2, SETTINGS.max_jerk_m_s3),
    (
        math.radians(SETTINGS.max_yaw_acceleration_deg_s2),
        math.radians(SETTINGS.max_yaw_jerk_deg_s3),
    ),
)
"""The largest acceleration and jerk of the horizontal velocity, the vertical one, the yaw rate."""

anything = st.floats(allow_nan=True, allow_infinity=True)
plausible = st.floats(-12, 12)
number = st.one_of(plausible, anything)
setpoints = st.builds(VelocitySetpoint, number, number, number, number)
unknown = st.one_of(st.none(), st.floats(-80, 80), anything)
contexts = st.builds(FlightContext, unknown, unknown, unknown, unknown, unknown, unknown, unknown)
steps = st.one_of(st.just(0.02), st.floats(0, 0.3), st.floats(1e-6, 1e-3))


class AnythingGoesIn(RuleBasedStateMachine):
    """Plays all kinds of calls, and measures what comes out from the outside alone."""

    def __init__(self):
        super().__init__()
        self.envelope = Envelope(SETTINGS)
        self.clock = 100.0
        self.envelope.start(now_s=self.clock)
        self.out = VelocitySetpoint()
        self.accelerations = (0.0, 0.0, 0.0)

    def call(self, limited, now_s):
        dt = 0.0
        if math.isfinite(now_s) and not 0 < now_s - self.clock < SHORTEST_S:
            dt = min(max(now_s - self.clock, 0.0), SETTINGS.max_interval_s)
            self.clock = now_s
        self.check_change(self.out, limited.allowed, dt)
        self.out = limited.allowed

    def check_change(self, before, after, dt):
        level = complex(after.forward_m_s - before.forward_m_s, after.right_m_s - before.right_m_s)
        sink = after.down_m_s - before.down_m_s
        turn = after.yaw_rate_rad_s - before.yaw_rate_rad_s
        if dt == 0:
            assert level == sink == turn == 0
            return
        changes = level / dt, sink / dt, turn / dt
        for now, last, (acceleration, jerk) in zip(
            changes, self.accelerations, LIMITS, strict=True
        ):
            assert abs(now) <= acceleration + ROUNDING
            assert abs(now - last) <= jerk * dt + ROUNDING
        self.accelerations = changes

    @rule(asked=setpoints, context=contexts, dt=steps)
    def ask(self, asked, context, dt):
        now_s = self.clock + dt
        self.call(self.envelope.limit(asked, now_s, context), now_s)

    @rule(asked=setpoints, context=contexts, count=st.integers(2, 60))
    def insist(self, asked, context, count):
        for _ in range(count):
            self.ask(asked, context, 0.02)

    @rule(asked=setpoints, context=contexts, now_s=anything.filter(lambda t: not abs(t) > 1e9))
    def ask_at_any_time(self, asked, context, now_s):
        self.call(self.envelope.limit(asked, now_s, context), now_s)

    @rule(now_s=st.sampled_from([math.nan, math.inf, -math.inf]), asked=setpoints)
    def ask_at_no_time(self, asked, now_s):
        self.call(self.envelope.limit(asked, now_s, FlightContext()), now_s)

    @rule(dt=steps)
    def hold(self, dt):
        now_s = self.clock + dt
        self.call(self.envelope.limit(HOLD, now_s, FlightContext()), now_s)

    @rule(velocity=setpoints)
    def start_again(self, velocity):
        self.envelope.start(velocity, self.clock)
        self.out = self.envelope.limit(velocity, self.clock, FlightContext()).allowed
        self.accelerations = (0.0, 0.0, 0.0)

    @invariant()
    def within_bounds(self):
        assert self.out.is_finite
        speed = math.hypot(self.out.forward_m_s, self.out.right_m_s)
        assert speed <= SETTINGS.max_speed_m_s + 1e-6
        assert -SETTINGS.max_climb_m_s - 1e-6 <= self.out.down_m_s
        assert self.out.down_m_s <= SETTINGS.max_descent_m_s + 1e-6
        assert abs(self.out.yaw_rate_rad_s) <= MAX_YAW_RATE + 1e-8


@pytest.mark.slow
@given(
    st.lists(
        st.tuples(st.builds(VelocitySetpoint, *4 * [plausible]), st.integers(1, 40)), max_size=8
    )
)
def test_a_hold_ends_exactly_and_as_soon_as_the_limits_allow(wishes):
    """A vehicle that is taken for standing, and moves on by a rounding error, is not released."""
    envelope, now_s = Envelope(replace(SETTINGS, fence_radius_m=None, min_distance_m=None)), 0.0
    envelope.start(HOLD, now_s)
    for asked, count in wishes:
        for _ in range(count):
            now_s += 0.02
            envelope.limit(asked, now_s, FlightContext(height_m=20.0))
    steps = []
    for _ in range(math.ceil(5.0 / 0.02)):
        now_s += 0.02
        allowed = envelope.limit(HOLD, now_s, FlightContext()).allowed
        level = complex(allowed.forward_m_s, allowed.right_m_s)
        steps.append((level, allowed.down_m_s, allowed.yaw_rate_rad_s))
    fastest = SETTINGS.max_speed_m_s, SETTINGS.max_climb_m_s, MAX_YAW_RATE
    for axis, most, (acceleration, jerk) in zip(
        zip(*steps, strict=True), fastest, LIMITS, strict=True
    ):
        # The acceleration is taken back, braking builds up, brakes, and is taken back.
        swung = most + acceleration**2 / (2 * jerk)
        longest_s = 2 * acceleration / jerk + swung / acceleration + 0.1
        assert not any(axis[math.ceil(longest_s / 0.02) :])


AnythingGoesIn.TestCase.settings = hypothesis_settings(max_examples=100, stateful_step_count=30)
TestAnythingGoesIn = pytest.mark.slow(AnythingGoesIn.TestCase)
