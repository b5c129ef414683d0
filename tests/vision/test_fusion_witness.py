"""What a detector's silence is worth, and what becomes of it."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from follower_vision.fusion.witness import Witness


def _witness(looks: list[bool]) -> Witness:
    witness = Witness()
    for seen in looks:
        witness.testify(seen, trusted=True)
    return witness


def _silent(witness: Witness, looks: int) -> Witness:
    for _ in range(looks):
        witness.testify(seen=False, trusted=False)
    return witness


def test_two_misses_of_a_reliable_detector_deny_the_track() -> None:
    reliable = _witness([True] * 30)
    assert not reliable.objects
    assert _silent(reliable, 1).wonders
    assert _silent(reliable, 1).denies


def test_a_detector_that_seldom_sees_the_target_says_nothing_by_missing_it() -> None:
    seldom = _witness([False] * 60)
    seldom.testify(seen=True, trusted=True)
    assert not _silent(seldom, 3).objects


def test_seeing_it_again_ends_the_objection() -> None:
    witness = _silent(_witness([True] * 10), 5)
    assert witness.denies
    witness.testify(seen=True, trusted=False)
    assert not witness.wonders


def test_an_objection_overruled_takes_long_to_come_again() -> None:
    witness = _silent(_witness([True] * 30), 3)
    witness.overrule()
    assert not witness.wonders
    assert not _silent(witness, 3).objects


@given(st.lists(st.booleans(), max_size=60), st.integers(0, 20))
def test_the_longer_the_silence_the_stronger_the_objection(looks: list[bool], silent: int) -> None:
    witness = _silent(_witness(looks), silent)
    levels = [(witness.wonders, witness.objects, witness.denies)]
    levels.append((_silent(witness, 1).wonders, witness.objects, witness.denies))
    assert all(later >= before for before, later in zip(*levels, strict=True))
    assert all(list(level) == sorted(level, reverse=True) for level in levels)
