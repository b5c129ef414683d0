"""Bootstrap intervals and the paired test, against what statistics knows in closed form."""

import math

import numpy as np
import pytest

from follower_vision.evaluation.intervals import (
    interval,
    paired_difference,
    paired_p,
)


def test_an_interval_holds_the_mean_and_narrows_with_more_sequences() -> None:
    rng = np.random.default_rng(1)
    few, many = rng.normal(0.5, 0.1, 10), rng.normal(0.5, 0.1, 400)
    for values in (few, many):
        low, high = interval(values)
        assert low < values.mean() < high
    assert np.ptp(interval(many)) < np.ptp(interval(few)) / 3


def test_a_paired_test_finds_a_difference_and_none() -> None:
    assert paired_p(np.full(12, 0.1)) < 0.01
    assert paired_p(np.array([0.1, -0.1] * 6)) == 1.0


def test_an_interval_is_that_of_the_normal_distribution_for_many_values() -> None:
    values = np.random.default_rng(3).normal(0.6, 0.2, 300)
    half = 1.96 * values.std() / math.sqrt(len(values))
    expected = (values.mean() - half, values.mean() + half)
    assert interval(values) == pytest.approx(expected, abs=0.1 * half)


def test_an_interval_of_equal_values_or_of_one_has_no_width() -> None:
    assert interval(np.full(9, 0.25)) == (0.25, 0.25)
    assert interval(np.array([0.7])) == (0.7, 0.7)


def test_the_test_finds_the_share_of_sign_flips_that_go_as_far() -> None:
    """Of the 2^6 flips of six equal differences, two reach the sum: all up and all down."""
    assert paired_p(np.full(6, 0.1)) == 2 / 64


def test_a_difference_is_that_of_the_first_over_the_second() -> None:
    rng = np.random.default_rng(5)
    others = rng.uniform(0, 0.8, 40)
    found = paired_difference(others + rng.normal(0.1, 0.02, 40), others)
    assert found.low < found.mean < found.high
    assert found.mean == pytest.approx(0.1, abs=0.01)
    assert found.p < 0.001
    back = paired_difference(others, others)
    assert (back.mean, back.low, back.high, back.p) == (0, 0, 0, 1)


def test_what_cannot_be_paired_is_refused() -> None:
    with pytest.raises(ValueError, match="shape"):
        paired_difference(np.zeros(3), np.zeros(2))
