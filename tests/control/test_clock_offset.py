"""The offset between a camera's turns and a gyro's: found, or honestly not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from follower_control.common.clock_offset import AngularRates, NoOverlapError, find_offset

FRAME_S = 1 / 30


def turning(time_s: np.ndarray, seed: int = 5) -> np.ndarray:
    """Body rates of a flight with turns that do not repeat, rad/s, (N, 3)."""
    rng = np.random.default_rng(seed)
    hertz = rng.uniform(0.1, 1.2, (3, 12))
    phases = rng.uniform(0, 2 * np.pi, (3, 12))
    waves = np.sin(2 * np.pi * hertz * time_s[:, None, None] + phases)
    return np.asarray(0.08 * waves.sum(axis=2))


def gyro(length_s: float = 60.0, rate_hz: float = 100.0, seed: int = 5) -> AngularRates:
    time_s = np.arange(0, length_s, 1 / rate_hz)
    return AngularRates.of_samples(time_s, turning(time_s, seed))


def camera(
    offset_s: float, length_s: float = 15.0, noise: float = 0.02, bias: float = 0.0, seed: int = 5
) -> AngularRates:
    """The same turns, seen by a video whose time is behind the gyro's by `offset_s`."""
    start = np.arange(0, length_s, FRAME_S)
    fine = start[:, None] + np.linspace(0, FRAME_S, 9)
    rates = turning((fine + offset_s).ravel(), seed).reshape(len(start), 9, 3).mean(axis=1)
    rates += np.random.default_rng(1).normal(0, noise, rates.shape) + bias
    return AngularRates(start, start + FRAME_S, rates)


@given(st.floats(0.5, 40.0))
@settings(max_examples=15)
def test_the_offset_is_found_to_a_fraction_of_a_frame(offset_s: float) -> None:
    found = find_offset(camera(offset_s), gyro())
    assert found.problems == []
    assert found.offset_s == pytest.approx(offset_s, abs=0.1 * FRAME_S)
    assert abs(found.offset_s - offset_s) <= 2 * found.unsure_s + 0.002
    assert found.scale == pytest.approx(1.0, abs=0.05)


def test_a_slow_bias_of_image_or_gyro_does_not_count() -> None:
    found = find_offset(camera(20.0, bias=0.3), gyro())
    assert found.problems == []
    assert found.offset_s == pytest.approx(20.0, abs=0.1 * FRAME_S)


@pytest.mark.parametrize("offset_s", [-4.0, 55.0])
def test_a_video_that_begins_before_the_log_or_ends_after_it_is_placed(offset_s: float) -> None:
    time_s = np.arange(0, 60.0, 0.01)
    found = find_offset(
        camera(offset_s, noise=0.01), AngularRates.of_samples(time_s, turning(time_s))
    )
    if offset_s < 0:
        assert found.offset_s == pytest.approx(offset_s, abs=0.2 * FRAME_S)
    else:
        # Five of fifteen seconds are not enough to say so.
        assert found.problems


def test_more_noise_is_a_larger_uncertainty() -> None:
    clean, noisy = (find_offset(camera(20.0, noise=n), gyro()) for n in (0.02, 0.3))
    assert noisy.unsure_s > 3 * clean.unsure_s
    assert noisy.peak < clean.peak


def test_the_next_best_is_another_peak_not_the_flank_of_the_best_one() -> None:
    smooth = np.hanning(51) / np.hanning(51).sum()
    white = np.random.default_rng(2).normal(0.0, 1.0, (9000, 3))
    rates = np.column_stack([np.convolve(axis, smooth, "same") for axis in white.T])
    time_s = np.arange(0, 90.0, 0.01)
    seen = AngularRates.of_samples(time_s[1000:8000] - 10.0, rates[1000:8000])
    found = find_offset(seen, AngularRates.of_samples(time_s, rates))
    assert found.offset_s == pytest.approx(10.0, abs=0.01)
    elsewhere = np.abs(found.lags_s - found.offset_s) > 0.5
    assert found.second == np.nanmax(found.correlation[elsewhere])
    assert found.second < 0.3


def test_no_offset_is_vaguer_than_the_range_that_was_tried() -> None:
    still = AngularRates(gyro().start_s, gyro().end_s, np.zeros_like(gyro().rates_rad_s))
    assert find_offset(camera(20.0), still, reach_s=3.0).unsure_s <= 6.0


def test_a_wrong_field_of_view_shows_as_a_scale_and_does_not_move_the_offset() -> None:
    seen = camera(20.0)
    wide = AngularRates(seen.start_s, seen.end_s, 1.3 * seen.rates_rad_s)
    found = find_offset(wide, gyro())
    assert found.scale == pytest.approx(1.3, abs=0.05)
    assert found.offset_s == pytest.approx(20.0, abs=0.1 * FRAME_S)


def test_a_hover_is_refused() -> None:
    rng = np.random.default_rng(3)
    time_s = np.arange(0, 60.0, 0.01)
    still = AngularRates.of_samples(time_s, rng.normal(0, 0.004, (len(time_s), 3)))
    start = np.arange(0, 15.0, FRAME_S)
    seen = AngularRates(start, start + FRAME_S, rng.normal(0, 0.01, (len(start), 3)))
    assert "hardly turns" in " ".join(find_offset(seen, still).problems)


def test_a_gyro_that_says_nothing_is_refused() -> None:
    time_s = np.arange(0, 60.0, 0.01)
    frozen = AngularRates.of_samples(time_s, np.zeros((len(time_s), 3)))
    assert "hardly turns" in " ".join(find_offset(camera(20.0), frozen).problems)


def test_the_log_of_another_flight_is_refused() -> None:
    found = find_offset(camera(20.0, seed=5), gyro(seed=6))
    assert found.problems


def test_turns_that_repeat_are_refused() -> None:
    time_s = np.arange(0, 60.0, 0.01)
    swing = 0.3 * np.sin(2 * np.pi * 0.5 * time_s)
    log = AngularRates.of_samples(time_s, np.column_stack([0 * swing, 0 * swing, swing]))
    start = np.arange(0, 15.0, FRAME_S)
    seen = 0.3 * np.sin(2 * np.pi * 0.5 * (start + FRAME_S / 2 + 20.0))
    noise = np.random.default_rng(2).normal(0, 0.02, (len(start), 3))
    rates = np.column_stack([0 * seen, 0 * seen, seen]) + noise
    found = find_offset(AngularRates(start, start + FRAME_S, rates), log)
    assert any("fits nearly as well" in problem for problem in found.problems)


def test_a_video_of_two_seconds_is_too_short() -> None:
    with pytest.raises(NoOverlapError, match="at least 4 s"):
        find_offset(camera(20.0, length_s=2.0), gyro())


def test_a_gap_in_the_video_does_no_harm() -> None:
    seen = camera(20.0)
    keep = (seen.start_s < 5) | (seen.start_s > 6)
    cut = AngularRates(seen.start_s[keep], seen.end_s[keep], seen.rates_rad_s[keep])
    assert find_offset(cut, gyro()).offset_s == pytest.approx(20.0, abs=0.2 * FRAME_S)
