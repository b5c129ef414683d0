"""Settings that change while the vehicle follows: no step in what is asked or allowed."""

import copy
import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from follower_control.envelope.envelope import Envelope
from follower_control.envelope.flight_context import FlightContext
from follower_control.envelope.settings import EnvelopeSettings
from follower_control.servo.pid import Pid, PidSettings
from follower_control.servo.servo import VisualServo
from follower_control.servo.settings import FollowMode, RangeFrom, ServoSettings
from follower_control.target.estimate import TargetEstimate
from follower_control.target.observation import BearingFrame
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_control.vehicle.state import Attitude, Clearance, LocalPosition, VehicleState

DT = 0.02
SIZE, DISTANCE = 1.5, 15.0
gains = st.floats(0.0, 5.0)


def loop() -> Pid:
    """A loop in the middle of its work: an error, an integral and a rate."""
    pid = Pid(PidSettings(kp=1.2, ki=0.4, kd=0.3))
    for i in range(200):
        pid.update(0.8 - 0.002 * i, 0.002 * i, DT, feed_forward=0.1)
    return pid


def goes_on(pid: Pid, times: int = 1) -> list[float]:
    return [pid.update(0.4 - 0.002 * i, 0.4 + 0.002 * i, DT, 0.1) for i in range(times)]


@given(gains, gains, gains, st.floats(0.2, 5.0))
def test_other_gains_make_no_step_in_a_loops_output(
    kp: float, ki: float, kd: float, unit: float
) -> None:
    pid, unchanged = loop(), loop()
    pid.change(PidSettings(kp=kp, ki=ki, kd=kd), unit=unit)
    after, usual = goes_on(pid)[0], goes_on(unchanged)[0]
    # A step of the fade, the new integral's first step and the error's own way may differ.
    most = (abs(kp) + abs(kd) + 2.0) / min(unit, 1.0) * (DT / 0.5 + 0.01) + abs(ki) * DT
    assert abs(after - (usual - 0.1) / unit - 0.1) <= most


def test_in_the_end_the_new_gains_rule() -> None:
    pid = loop()
    pid.change(PidSettings(kp=3.0))
    before = pid.integral
    output = [pid.update(0.5, 0.0, DT) for _ in range(500)][-1]
    assert pid.integral == before
    assert output == pytest.approx(3.0 * 0.5 + before, abs=1e-6)


def test_the_integral_and_the_derivative_are_kept() -> None:
    pid = loop()
    contribution = pid.integral
    pid.change(PidSettings(kp=1.2, ki=4.0, kd=0.3))
    assert pid.integral == contribution
    pid.change(PidSettings(kp=1.2, ki=4.0, kd=0.3), unit=2.0)
    assert pid.integral == contribution / 2.0


def test_a_change_that_changes_nothing_changes_no_bit() -> None:
    pid, unchanged = loop(), loop()
    pid.change(PidSettings(kp=1.2, ki=0.4, kd=0.3))
    assert goes_on(pid, 50) == goes_on(unchanged, 50)


def seen(now_s: float) -> TargetEstimate:
    return TargetEstimate(
        time_s=now_s,
        azimuth_rad=math.radians(8),
        elevation_rad=math.radians(-14),
        log_scale=math.log(SIZE / 19.0),
        azimuth_rate_rad_s=0.05,
        elevation_rate_rad_s=0.0,
        log_scale_rate_s=-0.02,
        covariance=np.eye(6),
        last_seen_s=now_s,
        frame=BearingFrame.WORLD,
    )


def vehicle(now_s: float) -> VehicleState:
    attitude = Attitude(0, 0, 0, 0, 0, 0, now_s)
    return VehicleState(attitude, LocalPosition(0, 0, -5, 2.0, 0, 0, now_s))


class Pursuit:
    """A servo that sees an error which stays, and whose setpoints are all flown."""

    def __init__(self, servo_settings: ServoSettings) -> None:
        self.servo = VisualServo(servo_settings, math.radians(-20))
        self.servo.start(HOLD)
        self.asked, self.step = HOLD, 0

    def fly(self, steps: int) -> list[VelocitySetpoint]:
        return [self._once() for _ in range(steps)]

    def _once(self) -> VelocitySetpoint:
        self.step += 1
        now_s = self.step * DT
        self.asked = self.servo.update(seen(now_s), vehicle(now_s), self.asked)
        return self.asked


CHANGES = [
    {"azimuth": PidSettings(kp=4.0)},
    {"range": PidSettings(kp=2.0, ki=0.3, kd=1.0)},
    {"elevation": PidSettings(kp=0.0)},
    {"distance_m": 30.0},
    {"target_size_m": 3.0},
    {"max_forward_m_s": 0.5, "max_vertical_m_s": 0.1, "max_yaw_rate_deg_s": 2.0},
    {"elevation_deg": -60.0},
    {"hold_height": True},
    {"side_deg": -90.0, "bearing": PidSettings(kp=2.0)},
    {"orbit_m_s": -4.0},
    {"overhead": PidSettings(kp=2.0), "overhead_yaw": "course"},
    {"target_acceleration_m_s2": 5.0, "course_filter_s": 0.1},
]


@pytest.mark.parametrize("mode", list(FollowMode))
@pytest.mark.parametrize("change", CHANGES, ids=lambda change: next(iter(change)))
def test_no_setting_makes_a_step_in_the_setpoint(
    mode: FollowMode, change: dict[str, object]
) -> None:
    began = ServoSettings(target_size_m=SIZE, distance_m=DISTANCE, mode=mode)
    pursuit = Pursuit(began)
    pursuit.fly(100)
    before = pursuit.asked
    pursuit.servo.change(replace(began, **change))  # type: ignore[arg-type]
    answers = [before, *pursuit.fly(50)]
    assert answers[1].values == pytest.approx(before.values, abs=1e-9)
    whole = [max(abs(b - a) for b in values) for a, values in _columns(before, answers)]
    for one, two in pairwise(answers):
        for a, b, far in zip(one.values, two.values, whole, strict=True):
            assert abs(b - a) <= 0.12 * far + 0.03


def _columns(before: VelocitySetpoint, answers: list[VelocitySetpoint]) -> list[tuple]:
    return list(zip(before.values, zip(*(one.values for one in answers), strict=True), strict=True))


def test_a_held_size_stays_as_far_away_when_the_distance_changes() -> None:
    began = ServoSettings(distance_m=DISTANCE)
    pursuit = Pursuit(began)
    pursuit.fly(50)
    before_m = pursuit.servo.errors.range_m
    pursuit.servo.change(replace(began, distance_m=10.0))
    pursuit.fly(1)
    assert pursuit.servo.errors.range_m == pytest.approx(before_m, rel=1e-3)


def test_a_distance_raised_in_flight_does_not_make_the_next_target_seem_farther() -> None:
    """Its size is unknown: it is as far away as was said before the flight, or nearer."""
    began = ServoSettings(distance_m=DISTANCE)
    for wanted_m, told_m in ((36.0, DISTANCE), (6.0, 6.0)):
        pursuit = Pursuit(began)
        pursuit.fly(50)
        pursuit.servo.change(replace(began, distance_m=wanted_m))
        pursuit.servo.start(HOLD)
        pursuit.fly(1)
        assert pursuit.servo.errors.range_m == pytest.approx(told_m, rel=1e-3)


@pytest.mark.parametrize(("size_m", "wanted_m"), [(0.8, 150.0), (0.8, 300.0), (6.0, 4.5)])
def test_on_the_way_to_a_far_other_distance_it_never_moves_the_wrong_way(
    size_m: float, wanted_m: float
) -> None:
    """The target seems `size_m` / SIZE * 19 m away, and that is what is wanted at first."""
    there_m = size_m / SIZE * 19.0
    began = ServoSettings(target_size_m=size_m, distance_m=there_m)
    pursuit = Pursuit(began)
    pursuit.fly(100)
    pursuit.servo.change(replace(began, distance_m=wanted_m))
    for _ in range(200):
        pursuit.fly(1)
        assert pursuit.servo.errors.range_m == pytest.approx(there_m, rel=0.05)
        assert pursuit.servo.errors.log_range * (there_m - wanted_m) >= -1e-3


def test_a_standing_target_ten_times_too_far_away_is_not_believed_to_run_from_us() -> None:
    """We fly to it at 8 m/s; it is 120 m away, and 5 m are wanted."""
    servo = VisualServo(ServoSettings(target_size_m=SIZE, distance_m=5.0), math.radians(-20))
    servo.start(HOLD)
    asked = HOLD
    for step in range(1, 300):
        now_s = step * DT
        north_m = 8.0 * now_s
        away_m = math.hypot(120.0 - north_m, 5.0)
        estimate = replace(
            seen(now_s),
            azimuth_rad=0.0,
            elevation_rad=-math.asin(5.0 / away_m),
            log_scale=math.log(SIZE / away_m),
            azimuth_rate_rad_s=0.0,
            log_scale_rate_s=8.0 / away_m,
        )
        position = LocalPosition(north_m, 0, -5, 8.0, 0, 0, now_s)
        asked = servo.update(estimate, replace(vehicle(now_s), position=position), asked)
        assert servo.errors.range_m <= 50.0 + 1e-9
        assert abs(servo.errors.target_speed_m_s) < 1.0


def test_a_change_while_nothing_is_steered_leaves_nothing_behind() -> None:
    wanted = ServoSettings(target_size_m=SIZE, distance_m=10.0)
    changed, fresh = Pursuit(ServoSettings(target_size_m=SIZE)), Pursuit(wanted)
    changed.servo.change(wanted)
    changed.servo.start(HOLD)
    assert changed.fly(50) == fresh.fly(50)


BEGAN = EnvelopeSettings(
    min_height_m=None, ceiling_m=None, fence_radius_m=None, min_distance_m=None
)


@pytest.mark.slow
@settings(max_examples=40)
@given(
    st.floats(0.5, 9.0),
    st.floats(0.2, 1.9),
    st.floats(-12, 12),
    st.floats(-12, 12),
    st.floats(-3, 3),
    st.integers(1, 150),
)
def test_a_lower_limit_brings_a_fast_vehicle_down_within_acceleration_and_jerk(
    top: float, steep: float, forward: float, right: float, down: float, when: int
) -> None:
    lower = replace(BEGAN, max_speed_m_s=top, max_climb_m_s=steep, max_descent_m_s=steep)
    envelope, asked = Envelope(BEGAN), VelocitySetpoint(forward, right, down)
    envelope.start(HOLD, 0.0)
    velocities, accelerations = [], []
    for i in range(1, when + 400):
        if i == when:
            envelope.change(lower)
        allowed = envelope.limit(asked, i * DT, FlightContext()).allowed
        velocities.append((complex(allowed.forward_m_s, allowed.right_m_s), allowed.down_m_s))
    for (v, w), (v2, w2) in pairwise(velocities):
        accelerations.append((v2 - v) / DT)
        assert abs(v2 - v) <= BEGAN.max_acceleration_m_s2 * DT + 1e-9
        assert abs(w2 - w) <= BEGAN.max_acceleration_m_s2 * DT + 1e-9
    for a, a2 in pairwise(accelerations):
        assert abs(a2 - a) <= BEGAN.max_jerk_m_s3 * DT + 1e-6
    assert abs(velocities[-1][0]) <= top + 1e-6
    assert abs(velocities[-1][1]) <= steep + 1e-6


@pytest.mark.slow
@settings(max_examples=40)
@given(st.floats(1, 59), st.floats(-2, 2), st.integers(1, 60))
def test_a_lower_yaw_rate_is_reached_within_yaw_acceleration_and_jerk(
    top_deg_s: float, turn: float, when: int
) -> None:
    envelope, asked = Envelope(BEGAN), VelocitySetpoint(yaw_rate_rad_s=turn)
    envelope.start(HOLD, 0.0)
    turns = []
    for i in range(1, when + 100):
        if i == when:
            envelope.change(replace(BEGAN, max_yaw_rate_deg_s=top_deg_s))
        turns.append(envelope.limit(asked, i * DT, FlightContext()).allowed.yaw_rate_rad_s)
    accelerations = [math.degrees(b - a) / DT for a, b in pairwise((0.0, *turns))]
    assert max(map(abs, accelerations)) <= BEGAN.max_yaw_acceleration_deg_s2 + 1e-6
    assert BEGAN.max_yaw_jerk_deg_s3 is not None
    for a, a2 in pairwise((0.0, *accelerations)):
        assert abs(a2 - a) <= BEGAN.max_yaw_jerk_deg_s3 * DT + 1e-4
    assert abs(math.degrees(turns[-1])) <= top_deg_s + 1e-6


@pytest.mark.parametrize("key", ["max_jerk_m_s3", "max_yaw_acceleration_deg_s2"])
def test_the_envelopes_acceleration_and_jerk_stay_as_they_were(key: str) -> None:
    envelope = Envelope(BEGAN)
    before = copy.deepcopy(BEGAN)
    with pytest.raises(ValueError, match=key):
        envelope.change(replace(BEGAN, **{key: 3.0}))
    envelope.change(before)


@pytest.mark.parametrize(("clearance", "above_m"), [(None, 5.0), (3.0, 3.0), (9.0, 9.0)])
def test_the_range_by_the_ground_is_by_what_measures_it_else_by_home(
    clearance: float | None, above_m: float
) -> None:
    by_ground = ServoSettings(range_from=RangeFrom.GROUND, target_middle_m=0.8)
    servo = VisualServo(by_ground, math.radians(-20))
    servo.start(HOLD)
    asked = HOLD
    for step in range(1, 50):
        now_s = step * DT
        standing = replace(vehicle(now_s), position=LocalPosition(0, 0, -5, 0, 0, 0, now_s))
        if clearance is not None:
            standing = replace(standing, clearance=Clearance(clearance, now_s))
        still = replace(seen(now_s), azimuth_rate_rad_s=0.0, log_scale_rate_s=0.0)
        asked = servo.update(still, standing, asked)
    assert servo.errors.range_m == pytest.approx((above_m - 0.8) / math.sin(math.radians(14)))
