"""The estimator: converges, predicts, gates, restarts, and folds nothing bad in."""

import math
from dataclasses import replace

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter

from follower_control.target.estimator import TargetEstimator
from follower_control.target.observation import BearingFrame, BearingObservation, GateVerdict
from follower_control.target.settings import EstimatorSettings
from follower_vision.geometry.line_of_sight import LineOfSight, wrap_angle

RATES = (0.3, -0.05, 0.1)


def observation(
    time_s, azimuth=0.0, elevation=-0.3, log_scale=-2.0, **others
) -> BearingObservation:
    return BearingObservation(
        LineOfSight(wrap_angle(azimuth), elevation), log_scale, time_s, **others
    )


def moving(time_s: float, start=(0.0, -0.3, -2.0), rng=None, noise=(0.005, 0.005, 0.03)):
    values = np.add(start, np.multiply(RATES, time_s))
    if rng is not None:
        values = values + rng.normal(0, noise)
    return observation(time_s, *values)


def fed(times, **options) -> TargetEstimator:
    estimator = TargetEstimator()
    for time_s in times:
        estimator.observe(moving(time_s, **options))
    return estimator


def test_nothing_is_known_before_the_first_sighting():
    assert TargetEstimator().estimate(1.0) is None


def test_the_first_sighting_is_taken_as_it_is():
    estimator = TargetEstimator()
    assert estimator.observe(observation(1.0, 0.5)) is GateVerdict.STARTED
    estimate = estimator.estimate(1.0)
    assert (estimate.azimuth_rad, estimate.azimuth_rate_rad_s) == (0.5, 0.0)
    assert estimate.age_s == 0.0


@pytest.mark.parametrize("start_azimuth", [0.0, 2.9], ids=["ahead", "across the seam"])
def test_it_learns_the_rates_of_a_steady_target_and_predicts_it(start_azimuth):
    start = (start_azimuth, -0.3, -2.0)
    estimator = fed(np.arange(0, 3, 0.03), start=start)
    estimate = estimator.estimate(3.5)
    assert rates(estimate) == pytest.approx(RATES, abs=0.005)
    assert wrap_angle(estimate.azimuth_rad - start_azimuth - 1.05) == pytest.approx(0, abs=0.01)
    assert -math.pi <= estimate.azimuth_rad < math.pi
    assert estimate.age_s == pytest.approx(3.5 - 2.97)


def test_it_is_filterpys_kalman_filter():
    """Step for step with filterpy's own equations, over uneven intervals."""
    rng, settings = np.random.default_rng(3), EstimatorSettings()
    estimator, kalman, before_s = TargetEstimator(settings), KalmanFilter(dim_x=6, dim_z=3), 0.0
    kalman.H = np.eye(3, 6)
    accelerations = (
        math.radians(settings.azimuth_acceleration_deg_s2),
        math.radians(settings.elevation_acceleration_deg_s2),
        settings.log_scale_acceleration_s2,
    )
    for time_s in np.cumsum(rng.choice([0.02, 0.03, 0.15], 60)).tolist():
        seen = moving(time_s, rng=rng)
        estimator.observe(seen)
        if before_s == 0.0:
            kalman.x, kalman.P = (
                np.array([*seen.values, 0, 0, 0]),
                estimator.estimate(time_s).covariance,
            )
        else:
            step_s = time_s - before_s
            kalman.F = np.eye(6) + step_s * np.eye(6, k=3)
            noises = [Q_continuous_white_noise(2, step_s, a**2) for a in accelerations]
            kalman.Q = np.zeros((6, 6))
            for i, noise in enumerate(noises):
                kalman.Q[i::3, i::3] = noise
            kalman.predict()
            kalman.update(seen.values, R=np.diag(estimator._noise(seen)))
        before_s, mine = time_s, estimator.estimate(time_s)
        np.testing.assert_allclose(mine.covariance, kalman.P, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(
            (mine.azimuth_rad, mine.elevation_rad, mine.log_scale, *rates(mine)),
            kalman.x,
            rtol=1e-12,
            atol=1e-12,
        )


def rates(estimate) -> tuple[float, float, float]:
    return (
        estimate.azimuth_rate_rad_s,
        estimate.elevation_rate_rad_s,
        estimate.log_scale_rate_s,
    )


def test_uneven_intervals_do_not_detune_it():
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.choice([0.02, 0.03, 0.15], 80))
    estimate = fed(times).estimate(times[-1])
    assert estimate.azimuth_rate_rad_s == pytest.approx(RATES[0], abs=0.005)
    assert estimate.log_scale_rate_s == pytest.approx(RATES[2], abs=0.005)


def test_the_filter_beats_its_sightings_and_its_covariance_is_honest():
    errors, squares = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        estimate = fed(np.arange(0, 2, 0.033), rng=rng).estimate(1.98)
        truth = np.add((0.0, -0.3, -2.0), np.multiply(RATES, 1.98))
        error = truth - (estimate.azimuth_rad, estimate.elevation_rad, estimate.log_scale)
        errors.append(error)
        squares.append(error @ np.linalg.solve(estimate.covariance[:3, :3], error))
    deviation = np.std(errors, axis=0)
    assert (deviation < (0.004, 0.004, 0.02)).all()
    # The process noise expects manoeuvres that are absent here: errors may be smaller, not larger.
    assert np.mean(squares) < 4.5


def test_asking_does_not_alter_the_filter():
    asked, quiet = fed(np.arange(0, 1, 0.03)), fed(np.arange(0, 1, 0.03))
    for now_s in np.arange(1, 2, 0.02):
        asked.estimate(now_s)
    later = moving(1.2)
    assert asked.observe(later) is quiet.observe(later)
    a, b = asked.estimate(1.3), quiet.estimate(1.3)
    assert a.azimuth_rad == b.azimuth_rad
    np.testing.assert_array_equal(a.covariance, b.covariance)


def test_the_longer_unseen_the_less_certain():
    estimator = fed(np.arange(0, 1, 0.03))
    spreads = [np.diag(estimator.estimate(t).covariance)[:3] for t in (1.0, 1.5, 2.5)]
    assert (np.diff(spreads, axis=0) > 0).all()


def test_after_long_unseen_there_is_no_estimate_and_the_next_sighting_starts_anew():
    estimator = fed(np.arange(0, 1, 0.03))
    assert estimator.estimate(3.5) is None
    assert estimator.observe(observation(3.5, 1.5)) is GateVerdict.RESTARTED
    assert estimator.estimate(3.5).azimuth_rate_rad_s == 0.0


def test_it_never_predicts_backwards():
    assert fed(np.arange(0, 1, 0.03)).estimate(0.5).time_s == pytest.approx(0.99)


@pytest.mark.parametrize("now_s", [math.nan, math.inf, -math.inf, 1e300])
def test_no_estimate_for_no_time(now_s):
    assert fed([0.0, 0.1]).estimate(now_s) is None


@pytest.mark.parametrize(
    ("bad", "verdict"),
    [
        (moving(0.99), GateVerdict.OUT_OF_ORDER),
        (moving(0.5), GateVerdict.OUT_OF_ORDER),
        (observation(math.nan), GateVerdict.NOT_FINITE),
        (observation(1.1, log_scale=math.nan), GateVerdict.NOT_FINITE),
        (replace(moving(1.1), line_of_sight=LineOfSight(math.inf, 0)), GateVerdict.NOT_FINITE),
    ],
)
def test_what_is_old_repeated_or_not_finite_is_refused(bad, verdict):
    estimator = fed(np.linspace(0, 0.99, 34))
    before = estimator.estimate(1.2)
    assert estimator.observe(bad) is verdict
    after = estimator.estimate(1.2)
    assert after.azimuth_rad == before.azimuth_rad
    np.testing.assert_array_equal(after.covariance, before.covariance)


@pytest.mark.parametrize(
    "jump", [{"azimuth": 1.2}, {"elevation": 0.5}, {"log_scale": -0.5}], ids=lambda j: next(iter(j))
)
def test_one_wild_sighting_is_gated_and_leaves_no_trace(jump):
    wild, clean = fed(np.arange(0, 1, 0.03)), fed(np.arange(0, 1, 0.03))
    assert wild.observe(observation(1.0, **{"azimuth": 0.3, **jump})) is GateVerdict.GATED
    assert wild.observe(moving(1.03)) is clean.observe(moving(1.03)) is GateVerdict.FUSED
    assert wild.estimate(1.1).azimuth_rad == clean.estimate(1.1).azimuth_rad


def test_a_persistent_jump_restarts_the_filter_on_it():
    settings = EstimatorSettings()
    estimator = fed(np.arange(0, 1, 0.03))
    verdicts = [
        estimator.observe(observation(1.0 + 0.03 * i, 2.0)) for i in range(settings.gated_in_a_row)
    ]
    assert verdicts == [GateVerdict.GATED] * (settings.gated_in_a_row - 1) + [GateVerdict.RESTARTED]
    assert estimator.estimate(1.2).azimuth_rad == pytest.approx(2.0)


def test_good_sightings_in_between_keep_wild_ones_from_adding_up():
    estimator = fed(np.arange(0, 1, 0.03))
    for i in range(40):
        time_s = 1.0 + 0.03 * i
        wild = i % 3 > 0
        verdict = estimator.observe(observation(time_s, 2.5) if wild else moving(time_s))
        assert verdict is (GateVerdict.GATED if wild else GateVerdict.FUSED)


def test_a_change_of_frame_starts_anew():
    estimator = fed(np.arange(0, 1, 0.03))
    verdict = estimator.observe(observation(1.0, 0.0, frame=BearingFrame.BODY))
    assert verdict is GateVerdict.RESTARTED
    assert estimator.estimate(1.0).frame is BearingFrame.BODY


def test_a_cut_box_moves_the_estimate_less():
    whole, cut = fed(np.arange(0, 1, 0.03)), fed(np.arange(0, 1, 0.03))
    before = whole.estimate(1.0).log_scale
    whole.observe(observation(1.0, 0.3, -0.35, log_scale=before - 0.08))
    cut.observe(observation(1.0, 0.3, -0.35, log_scale=before - 0.08, is_cut=True))
    moved = [abs(estimator.estimate(1.0).log_scale - before) for estimator in (whole, cut)]
    assert moved[1] < 0.3 * moved[0]


def test_near_the_nadir_a_wild_azimuth_is_no_surprise():
    estimator = TargetEstimator()
    rng = np.random.default_rng(0)
    verdicts = [
        estimator.observe(observation(0.03 * i, rng.uniform(-0.5, 0.5), math.radians(-89.5)))
        for i in range(60)
    ]
    assert verdicts.count(GateVerdict.GATED) == 0


def test_reset_forgets_the_target_and_the_time():
    estimator = fed(np.arange(0, 1, 0.03))
    estimator.reset()
    assert estimator.estimate(1.0) is None
    assert estimator.observe(moving(0.2)) is GateVerdict.STARTED


@pytest.mark.parametrize("field", ["gate", "log_scale_noise", "restart_after_s"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_nonsense_settings_are_refused(field, value):
    with pytest.raises(ValueError, match=field):
        EstimatorSettings(**{field: value})
