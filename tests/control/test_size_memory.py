"""The size of a target, from where the ground says that it stands."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_control.target.observation import SizeMemory

lengths = st.floats(0.1, 50.0)


def test_nothing_is_near_before_a_size_is_known() -> None:
    assert SizeMemory().range_m(-2.0) == math.inf


@given(lengths, lengths, lengths)
def test_a_known_size_is_as_far_away_as_it_looks_small(
    size_m: float, first_m: float, then_m: float
) -> None:
    known = SizeMemory()
    known.learn(first_m, math.log(size_m / first_m))
    assert known.range_m(math.log(size_m / then_m)) == pytest.approx(then_m)


@given(st.lists(st.floats(-0.3, 0.3), min_size=1, max_size=30))
def test_it_is_the_mean_of_the_first_sightings(errors: list[float]) -> None:
    known = SizeMemory()
    for error in errors:
        known.learn(10.0, math.log(2.0 / 10.0) + error)
    assert known.log_m == pytest.approx(math.log(2.0) + sum(errors) / len(errors))


def test_what_grows_later_is_not_believed_to_be_larger() -> None:
    known = SizeMemory()
    for number in range(300):
        known.learn(10.0, math.log(2.0 / 10.0) + max(0.0, 0.01 * (number - 30)))
    assert known.log_m == pytest.approx(math.log(2.0))


def test_an_assumption_gives_way_to_the_first_sighting_and_a_told_size_to_none() -> None:
    known = SizeMemory()
    known.assume(12.0, 0.0)
    assert known.range_m(0.0) == pytest.approx(12.0)
    known.learn(6.0, 0.0)
    assert known.range_m(0.0) == pytest.approx(6.0)
    known.assume(99.0, 0.0)
    known.set(3.0)
    known.learn(50.0, 0.0)
    assert known.log_m == pytest.approx(math.log(3.0))
