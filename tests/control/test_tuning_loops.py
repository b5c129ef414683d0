"""Margins of loops that are known in closed form, and gains that keep what was wished for."""

import math
from dataclasses import replace

import control
import numpy as np
import pytest

from follower_control.envelope.settings import EnvelopeSettings
from follower_control.servo.pid import PidSettings
from follower_control.servo.settings import RangeFrom, ServoSettings
from follower_control.target.settings import EstimatorSettings
from follower_control.tuning.axes import Axis, LoopSettings, SteadyFilter, axis_loop
from follower_control.tuning.axis_loop import AxisLoop, Conditions, LoopDelays
from follower_control.tuning.rational import (
    Array,
    ComplexArray,
    Rational,
    bandwidth_rad_s,
    frequencies,
    integrator,
    margins_of,
)
from follower_control.tuning.response_model import ResponseModel, VehicleModel
from follower_control.tuning.synthesis import TuningGoal, tune

VEHICLE = VehicleModel(
    forward=ResponseModel(1.0, 0.3, 0.4, 1.0),
    right=ResponseModel(1.0, 0.3, 0.4, 1.0),
    down=ResponseModel(1.0, 0.15, 0.3, 0.7),
    yaw_rate=ResponseModel(1.0, 0.17, 0.2),
)
FOLLOWER = LoopSettings(ServoSettings(), EstimatorSettings(), EnvelopeSettings())
HERE = Conditions()


def loop(axis: Axis, conditions: Conditions = HERE, **gains: float):
    present = replace(FOLLOWER.gains(axis), **gains)
    return axis_loop(axis, present, VEHICLE, FOLLOWER, conditions)


@pytest.mark.parametrize(("gain", "dead_s"), [(1.0, 0.2), (2.5, 0.1), (0.4, 0.9)])
def test_an_integrator_with_dead_time_has_the_margins_of_the_textbook(
    gain: float, dead_s: float
) -> None:
    grid = frequencies()
    found = margins_of(grid, integrator(gain).delayed(dead_s).at(grid))
    phase = math.pi / 2 - gain * dead_s
    assert found.crossover_rad_s == pytest.approx(gain, rel=1e-4)
    assert found.phase_rad == pytest.approx(phase, abs=1e-4)
    assert found.delay_s == pytest.approx(phase / gain, rel=1e-3)
    assert found.gain == pytest.approx(math.pi / (2 * gain * dead_s), rel=1e-3)
    assert found.gain_at_rad_s == pytest.approx(math.pi / (2 * dead_s), rel=1e-3)


def test_a_loop_without_delay_that_never_turns_far_bears_any_gain() -> None:
    grid = frequencies()
    found = margins_of(grid, integrator(1.0).at(grid))
    assert found.gain == math.inf
    assert found.phase_rad == pytest.approx(math.pi / 2)
    assert found.max_sensitivity == pytest.approx(1.0, abs=1e-3)


def test_the_margins_agree_with_python_control() -> None:
    grid = frequencies()
    plant = Rational((2.0,), (0.3, 1.0)) * integrator() * Rational((1.0,), (0.1, 1.0))
    found = margins_of(grid, plant.at(grid))
    gain, phase, stability, crossing, crossover, _ = control.stability_margins(plant.system())
    assert found.gain == pytest.approx(gain, rel=1e-3)
    assert math.degrees(found.phase_rad) == pytest.approx(phase, abs=0.01)
    assert found.max_sensitivity == pytest.approx(1 / stability, rel=1e-3)
    assert found.gain_at_rad_s == pytest.approx(crossing, rel=1e-3)
    assert found.crossover_rad_s == pytest.approx(crossover, rel=1e-3)


def test_the_bandwidth_of_a_low_pass_is_one_over_its_time_constant() -> None:
    grid = frequencies()
    assert bandwidth_rad_s(grid, Rational((1.0,), (0.5, 1.0)).at(grid)) == pytest.approx(
        2.0, rel=1e-3
    )
    assert bandwidth_rad_s(grid, Rational((1.0,)).at(grid)) == math.inf


def test_pade_is_the_delay_where_the_loops_live() -> None:
    grid = frequencies(0.1, 10.0)
    system = Rational((1.0,), (0.2, 1.0), 0.4)
    by_pade = control.frequency_response(system.system(), grid).complex
    assert np.abs(by_pade - system.at(grid)).max() < 0.01


def test_the_settled_filter_follows_a_steady_motion_without_error() -> None:
    sight = SteadyFilter.of(0.35, 0.004, 1 / 30)
    slow = np.array([1e-4])
    for age_s in (0.0, 0.1):
        # d/ds of the response at 0 is how late a ramp comes out.
        late_s = -np.angle(sight.value(age_s).at(slow))[0] / slow[0]
        assert late_s == pytest.approx(0.0, abs=1e-3)
    assert sight.rate(0.1).at(slow)[0] / (1j * slow[0]) == pytest.approx(1.0, abs=1e-3)


def test_more_noise_makes_the_filter_slower() -> None:
    quick, slow = (SteadyFilter.of(0.35, noise, 1 / 30) for noise in (0.002, 0.02))
    assert quick.rate_gain_per_s2 > slow.rate_gain_per_s2


@pytest.mark.parametrize("axis", Axis)
def test_the_default_loops_are_stable_and_follow_what_is_wanted(axis: Axis) -> None:
    found = loop(axis)
    assert found.is_stable()
    _, values = found.step_response(60.0)
    assert values[0] == pytest.approx(0.0, abs=1e-6)
    assert values[-1] == pytest.approx(1.0, abs=0.05)


def test_a_gain_above_the_gain_margin_makes_each_loop_unstable_and_one_below_does_not() -> None:
    # The range loop's feed-forward has a gain of its own: its margin is not that of kp.
    for axis in (Axis.AZIMUTH, Axis.ELEVATION):
        present, margin = FOLLOWER.gains(axis), loop(axis).margins().gain
        for factor, stable in ((0.93, True), (1.07, False)):
            more = {name: factor * margin * getattr(present, name) for name in ("kp", "ki", "kd")}
            assert loop(axis, **more).is_stable() is stable


def test_a_delay_beyond_the_delay_margin_makes_a_loop_unstable() -> None:
    margin = loop(Axis.AZIMUTH).margins().delay_s
    for factor, stable in ((0.95, True), (1.05, False)):
        later = replace(HERE, delays=LoopDelays(extra_s=factor * margin))
        assert loop(Axis.AZIMUTH, later).is_stable() is stable


def test_a_target_at_steady_speed_is_kept_without_error_by_the_feed_forward() -> None:
    for axis in (Axis.AZIMUTH, Axis.RANGE):
        _, error = loop(axis).disturbance_response(60.0)
        assert abs(error).max() > 0.05
        assert error[-1] == pytest.approx(0.0, abs=0.03)


@pytest.mark.parametrize("hold_height", [False, True])
def test_the_speed_of_a_target_far_below_is_fed_forward_as_it_is(hold_height: bool) -> None:
    """Whether climbing with it or not: without an integral nothing of the error stays."""
    follower = replace(FOLLOWER, servo=ServoSettings(hold_height=hold_height))
    below = Conditions(elevation_rad=-1.0)
    found = axis_loop(Axis.RANGE, PidSettings(kp=0.1), VEHICLE, follower, below)
    _, error = found.disturbance_response(60.0)
    assert error[-1] == pytest.approx(0.0, abs=0.1)


def test_the_cameras_delay_hardly_matters_to_a_loop_unless_stamps_are_wrong() -> None:
    late = replace(HERE, delays=LoopDelays(camera_s=0.3))
    wrong = replace(HERE, delays=LoopDelays(camera_s=0.3, stamp_error_s=0.15))
    known = loop(Axis.AZIMUTH).margins()
    assert loop(Axis.AZIMUTH, late).margins() == known
    assert loop(Axis.AZIMUTH, wrong).margins().max_sensitivity > 1.1 * known.max_sensitivity
    for axis in (Axis.ELEVATION, Axis.RANGE):
        now, then = loop(axis).margins(), loop(axis, late).margins()
        assert then.gain == pytest.approx(now.gain, rel=0.05)
        assert then.max_sensitivity == pytest.approx(now.max_sensitivity, rel=0.05)
        assert loop(axis, wrong).margins().max_sensitivity > 1.1 * then.max_sensitivity


@pytest.mark.parametrize("axis", Axis)
@pytest.mark.parametrize("range_from", RangeFrom)
@pytest.mark.parametrize("most", [1.4, 1.6])
def test_tuned_gains_keep_the_sensitivity_and_settle(
    axis: Axis, range_from: RangeFrom, most: float
) -> None:
    follower = replace(FOLLOWER, servo=ServoSettings(range_from=range_from))
    found = tune(axis, VEHICLE, follower, HERE, TuningGoal(max_sensitivity=most, jitter_factor=3.0))
    assert found.reached, found.because
    assert found.loop.is_stable()
    assert found.loop.margins().max_sensitivity <= most
    assert min(found.gains.kp, found.gains.ki + 1e-12, found.gains.kd + 1e-12) > 0


def test_a_slow_loop_keeps_the_sensitivity_too() -> None:
    """Far below, climbing hardly changes the elevation: its loop is worst at 0.02 rad/s."""
    below = Conditions(elevation_rad=math.radians(-84))
    found = tune(Axis.ELEVATION, VEHICLE, FOLLOWER, below, TuningGoal())
    assert found.reached
    assert found.loop.margins().max_sensitivity <= 1.6


def test_a_wanted_bandwidth_is_met_or_said_to_be_out_of_reach() -> None:
    slow = tune(Axis.AZIMUTH, VEHICLE, FOLLOWER, HERE, TuningGoal(bandwidth_rad_s=0.8))
    assert slow.reached
    assert slow.loop.bandwidth_rad_s() == pytest.approx(0.8, rel=0.1)
    fast = tune(Axis.AZIMUTH, VEHICLE, FOLLOWER, HERE, TuningGoal(bandwidth_rad_s=15.0))
    assert not fast.reached
    assert fast.because
    assert fast.loop.margins().max_sensitivity <= 1.6


def test_what_no_gains_can_do_is_told_by_its_own_reason() -> None:
    """A bandwidth below the slowest loop that is tried has nothing to do with the margins."""
    below = tune(Axis.AZIMUTH, VEHICLE, FOLLOWER, HERE, TuningGoal(bandwidth_rad_s=0.01))
    assert not below.reached
    assert below.gains == FOLLOWER.gains(Axis.AZIMUTH)
    assert "0.01 rad/s" in below.because
    assert "Ms" not in below.because
    late = Conditions(delays=LoopDelays(camera_s=4.0, extra_s=4.0))
    robust = tune(Axis.ELEVATION, VEHICLE, FOLLOWER, late, TuningGoal(max_sensitivity=1.1))
    assert not robust.reached
    assert "Ms reaches 1.1" in robust.because


def test_gains_of_zero_are_a_beginning_like_any_other() -> None:
    """They shake nothing, so that no gains would shake little enough beside them."""
    servo = replace(ServoSettings(), azimuth=PidSettings(kp=0.0))
    found = tune(Axis.AZIMUTH, VEHICLE, replace(FOLLOWER, servo=servo), HERE, TuningGoal())
    assert found.reached, found.because
    assert found.gains.kp > 0.1


@pytest.mark.parametrize("odd", [PidSettings(kp=0.5, kd=1e6), PidSettings(kp=1e-9, ki=0.1)])
def test_gains_that_cannot_be_raised_in_their_ratio_are_tuned_in_others(odd: PidSettings) -> None:
    follower = replace(FOLLOWER, servo=replace(ServoSettings(), elevation=odd))
    found = tune(Axis.ELEVATION, VEHICLE, follower, HERE, TuningGoal(jitter_factor=100.0))
    assert found.loop.is_stable(), found.because
    assert found.gains.kd < 1.0 < 20 * found.gains.kp


@pytest.mark.parametrize(
    "tight",
    [
        replace(FOLLOWER, envelope=EnvelopeSettings(max_yaw_rate_deg_s=5.0)),
        replace(FOLLOWER, servo=ServoSettings(max_yaw_rate_deg_s=5.0)),
    ],
    ids=["envelope", "servo"],
)
def test_limits_that_allow_little_keep_the_gains_low(tight: LoopSettings) -> None:
    found = tune(Axis.AZIMUTH, VEHICLE, tight, HERE, TuningGoal())
    assert math.degrees(0.15 * found.gains.kp) <= 5.0
    assert "allow" in found.because


def test_what_is_no_model_or_wish_is_refused() -> None:
    for wrong in (
        lambda: ResponseModel(0.0, 0.1, 0.2),
        lambda: ResponseModel(1.0, -0.1, 0.2),
        lambda: ResponseModel(1.0, 0.1, math.nan),
        lambda: ResponseModel(1e-300, 0.1, 0.2),
        lambda: ResponseModel(1.0, 0.1, 1e200),
        lambda: ResponseModel(1.0, 0.1, 0.2, damping=0.0),
        lambda: ResponseModel(1.0, 0.1, 0.2, rate_limit=0.0),
        lambda: LoopDelays(camera_s=-0.1),
        lambda: LoopDelays(camera_s=0.05, stamp_error_s=0.1),
        lambda: Conditions(range_m=0.0),
        lambda: Conditions(elevation_rad=2.0),
        lambda: TuningGoal(max_sensitivity=1.0),
        lambda: TuningGoal(bandwidth_rad_s=0.0),
        lambda: SteadyFilter.of(1.0, 0.0, 0.03),
        lambda: Rational((1.0,), (0.0,)),
        lambda: Rational((1.0,), (1.0,), -1.0),
        lambda: PidSettings(kp=-1.0),
    ):
        with pytest.raises(ValueError, match=r"."):
            wrong()


def test_what_the_estimator_misses_of_our_own_motion_takes_margin() -> None:
    """What it has not followed yet of our closing in looks like the target's flight."""
    quick = replace(FOLLOWER, estimator=EstimatorSettings(log_scale_noise=0.001))
    usual = axis_loop(Axis.RANGE, FOLLOWER.gains(Axis.RANGE), VEHICLE, FOLLOWER, HERE)
    other = axis_loop(Axis.RANGE, quick.gains(Axis.RANGE), VEHICLE, quick, HERE)
    assert usual.margins().gain < 0.8 * other.margins().gain


def test_along_the_line_of_sight_a_horizontal_velocity_takes_more_of_the_range() -> None:
    """With the climb that keeps the elevation; without it, it takes less."""
    held = replace(FOLLOWER, servo=ServoSettings(hold_height=True))
    below, frequency = Conditions(elevation_rad=-0.4), np.array([0.01])
    along, level = (
        axis_loop(Axis.RANGE, one.gains(Axis.RANGE), VEHICLE, one, below).geometry.at(frequency)
        for one in (FOLLOWER, held)
    )
    assert abs(along[0] / level[0]) == pytest.approx(1 / math.cos(0.4) ** 2)


def test_a_vehicle_that_flies_too_slowly_for_seconds_is_driven_to_what_was_asked_for() -> None:
    """And answers a quick change as it does by itself."""
    weak = replace(VEHICLE, forward=ResponseModel(0.9, 0.3, 0.4, 1.0))
    found = axis_loop(Axis.RANGE, FOLLOWER.gains(Axis.RANGE), weak, FOLLOWER, HERE)
    slow, quick = np.array([1e-4]), np.array([50.0])
    assert abs(found.driven(slow)[0]) == pytest.approx(1.0, rel=1e-3)
    assert found.driven(quick)[0] == pytest.approx(found.plant.at(quick)[0], rel=0.01)
    # It costs margin, and the poles say so too.
    alone = replace(found, shortfall=None)
    assert found.margins().gain < 0.95 * alone.margins().gain
    for factor in (0.95, 1.05):
        scaled = replace(
            found,
            from_own=tuple(one.scaled(factor * found.margins().gain) for one in found.from_own),
        )
        assert scaled.is_stable() is (factor < 1)


def test_a_target_that_may_turn_hard_is_followed_faster_across_the_line_of_sight_alone() -> None:
    servo = replace(ServoSettings(), target_acceleration_across_m_s2=6.0)
    agile = replace(FOLLOWER, servo=servo)
    tone = np.array([1.0])
    for axis in Axis:
        usual, other = (
            _disturbance(axis_loop(axis, f.gains(axis), VEHICLE, f, HERE), tone)
            for f in (FOLLOWER, agile)
        )
        if axis is Axis.RANGE:
            assert other == pytest.approx(usual)
        else:
            assert abs(other[0]) < abs(usual[0])


def _disturbance(loop: AxisLoop, frequency_rad_s: Array) -> ComplexArray:
    """From the target's motion to the error."""
    answer = (loop.geometry * loop.from_target).at(frequency_rad_s)
    share = 1 - answer * loop.driven(frequency_rad_s) * loop.sensitivity(frequency_rad_s)
    return np.asarray(loop.geometry.at(frequency_rad_s) * share, np.complex128)
