"""Python's own pauses while a vehicle is steered."""

from __future__ import annotations

import gc
import sys

import pytest

from follower.flight.threads import short_pauses


def generations_collected() -> set[int]:
    """Return which generations are collected while many objects are kept, as a flight log does."""
    seen: set[int] = set()

    def note(phase: str, info: dict[str, int]) -> None:
        if phase == "start":
            seen.add(info["generation"])

    gc.callbacks.append(note)
    kept = [[number] for number in range(300_000)]
    gc.callbacks.remove(note)
    del kept
    return seen


@pytest.mark.slow
def test_what_a_flight_has_noted_is_not_looked_through_during_it() -> None:
    assert 2 in generations_collected()
    with short_pauses():
        assert generations_collected() == {0, 1}
    assert 2 in generations_collected()


def test_all_is_as_before_afterwards() -> None:
    before = gc.get_threshold(), sys.getswitchinterval()
    with short_pauses():
        assert sys.getswitchinterval() == pytest.approx(0.0005)
    assert (gc.get_threshold(), sys.getswitchinterval()) == before
