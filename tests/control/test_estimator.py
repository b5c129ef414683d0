"""The estimator: converges, predicts, gates, restarts, and folds nothing bad in."""

import math
from dataclasses import replace

import numpy as np
import pytest

from follower_control.estimator import EstimatorSettings, TargetEstimator, Verdict
from follower_control.sighting import SightFrame, Sighting
from follower_vision.lineofsight import LineOfSight, wrap_angle

RATES = (0.3, -0.05, 0.1)


def sighting(time_s, azimuth=0.0, elevation=-0.3, log_scale=-2.0, **others) -> Sighting:
    return Sighting(LineOfSight(wrap_angle(azimuth), elevation), log_scale, time_s, **others)


def moving(time_s: float, start=(0.0, -0.3, -2.0), rng=None, noise=(0.005, 0.005, 0.03)):
    values = np.add(start, np.multiply(RATES, time_s))
    if rng is not None:
        values = values + rng.normal(0, noise)
    return sighting(time_s, *values)


def fed(times, **options) -> TargetEstimator:
    estimator = TargetEstimator()
    for time_s in times:
        estimator.observe(moving(time_s, **options))
    return estimator


def test_nothing_is_known_before_the_first_sighting():
    assert TargetEstimator().estimate(1.0) is None


def test_the_first_sighting_is_taken_as_it_is():
    estimator = TargetEstimator()
    assert estimator.observe(sighting(1.0, 0.5)) is Verdict.STARTED
    estimate = estimator.estimate(1.0)
    assert (estimate.azimuth_rad, estimate.azimuth_rate_rad_s) == (0.5, 0.0)
    assert estimate.age_s == 0.0


@pytest.mark.parametrize("start_azimuth", [0.0, 2.9], ids=["ahead", "across the seam"])
def test_it_learns_the_rates_of_a_steady_target_and_predicts_it(start_azimuth):
    start = (start_azimuth, -0.3, -2.0)
    estimator = fed(np.arange(0, 3, 0.03), start=start)
    estimate = estimator.estimate(3.5)
    rates = (
        estimate.azimuth_rate_rad_s,
        estimate.elevation_rate_rad_s,
        estimate.log_scale_rate_s,
    )
    assert rates == pytest.approx(RATES, abs=0.005)
    assert wrap_angle(estimate.azimuth_rad - start_azimuth - 1.05) == pytest.approx(0, abs=0.01)
    assert -math.pi <= estimate.azimuth_rad < math.pi
    assert estimate.age_s == pytest.approx(3.5 - 2.97)


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
    assert estimator.observe(sighting(3.5, 1.5)) is Verdict.RESTARTED
    assert estimator.estimate(3.5).azimuth_rate_rad_s == 0.0


def test_it_never_predicts_backwards():
    assert fed(np.arange(0, 1, 0.03)).estimate(0.5).time_s == pytest.approx(0.99)


@pytest.mark.parametrize("now_s", [math.nan, math.inf, -math.inf, 1e300])
def test_no_estimate_for_no_time(now_s):
    assert fed([0.0, 0.1]).estimate(now_s) is None


@pytest.mark.parametrize(
    ("bad", "verdict"),
    [
        (moving(0.99), Verdict.OUT_OF_ORDER),
        (moving(0.5), Verdict.OUT_OF_ORDER),
        (sighting(math.nan), Verdict.NOT_FINITE),
        (sighting(1.1, log_scale=math.nan), Verdict.NOT_FINITE),
        (replace(moving(1.1), line_of_sight=LineOfSight(math.inf, 0)), Verdict.NOT_FINITE),
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
    assert wild.observe(sighting(1.0, **{"azimuth": 0.3, **jump})) is Verdict.GATED
    assert wild.gated == 1
    assert wild.observe(moving(1.03)) is clean.observe(moving(1.03)) is Verdict.FUSED
    assert wild.estimate(1.1).azimuth_rad == clean.estimate(1.1).azimuth_rad


def test_a_persistent_jump_restarts_the_filter_on_it():
    settings = EstimatorSettings()
    estimator = fed(np.arange(0, 1, 0.03))
    verdicts = [
        estimator.observe(sighting(1.0 + 0.03 * i, 2.0)) for i in range(settings.gated_in_a_row)
    ]
    assert verdicts == [Verdict.GATED] * (settings.gated_in_a_row - 1) + [Verdict.RESTARTED]
    assert estimator.estimate(1.2).azimuth_rad == pytest.approx(2.0)


def test_good_sightings_in_between_keep_wild_ones_from_adding_up():
    estimator = fed(np.arange(0, 1, 0.03))
    for i in range(40):
        time_s = 1.0 + 0.03 * i
        wild = i % 3 > 0
        verdict = estimator.observe(sighting(time_s, 2.5) if wild else moving(time_s))
        assert verdict is (Verdict.GATED if wild else Verdict.FUSED)


def test_a_change_of_frame_starts_anew():
    estimator = fed(np.arange(0, 1, 0.03))
    verdict = estimator.observe(sighting(1.0, 0.0, frame=SightFrame.BODY))
    assert verdict is Verdict.RESTARTED
    assert estimator.estimate(1.0).frame is SightFrame.BODY


def test_a_cut_box_moves_the_estimate_less():
    whole, cut = fed(np.arange(0, 1, 0.03)), fed(np.arange(0, 1, 0.03))
    before = whole.estimate(1.0).log_scale
    whole.observe(sighting(1.0, 0.3, -0.35, log_scale=before - 0.08))
    cut.observe(sighting(1.0, 0.3, -0.35, log_scale=before - 0.08, is_cut=True))
    moved = [abs(estimator.estimate(1.0).log_scale - before) for estimator in (whole, cut)]
    assert moved[1] < 0.3 * moved[0]


def test_near_the_nadir_a_wild_azimuth_is_no_surprise():
    estimator = TargetEstimator()
    rng = np.random.default_rng(0)
    verdicts = [
        estimator.observe(sighting(0.03 * i, rng.uniform(-0.5, 0.5), math.radians(-89.5)))
        for i in range(60)
    ]
    assert verdicts.count(Verdict.GATED) == 0


def test_reset_forgets_the_target_and_the_time():
    estimator = fed(np.arange(0, 1, 0.03))
    estimator.reset()
    assert estimator.estimate(1.0) is None
    assert estimator.observe(moving(0.2)) is Verdict.STARTED


@pytest.mark.parametrize("field", ["gate", "log_scale_noise", "restart_after_s"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_nonsense_settings_are_refused(field, value):
    with pytest.raises(ValueError, match=field):
        EstimatorSettings(**{field: value})
