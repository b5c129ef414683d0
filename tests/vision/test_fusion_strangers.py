"""Those who stood beside the target are not taken for it."""

from __future__ import annotations

import pytest

from follower_vision.box import Box
from follower_vision.fusion.history import History
from follower_vision.fusion.strangers import Strangers
from follower_vision.fusion.warp import Warp

STEP_S = 1 / 30
TARGET = Box(300, 100, 30, 60)
BESIDE = Box(360, 100, 30, 60)


def _history(frames: int = 1, pan: float = 0.0) -> History:
    history = History()
    for number in range(frames):
        history.add(number * STEP_S, Warp(right=pan if number else 0.0), TARGET)
    return history


def _goes_on(history: History, frames: int, pan: float = 0.0) -> None:
    for _ in range(frames):
        history.add(history.now.captured_s + STEP_S, Warp(right=pan), TARGET)


def _met(history: History) -> Strangers:
    strangers = Strangers()
    strangers.meet([BESIDE], history)
    return strangers


def test_a_strangers_place_is_refused_and_the_targets_is_not() -> None:
    history = _history()
    strangers = _met(history)
    assert strangers.refuse(BESIDE, TARGET, 0.0, history)
    assert not strangers.refuse(TARGET, TARGET, 0.0, history)
    assert not strangers.refuse(Box(300, 300, 30, 60), TARGET, 0.0, history)


def test_where_the_target_itself_should_be_nobody_is_refused() -> None:
    history = _history()
    assert not _met(history).refuse(BESIDE, BESIDE, 0.0, history)


@pytest.mark.parametrize("pan", [-12.0, 9.0])
def test_a_stranger_moves_with_the_ground_when_the_camera_swings(pan: float) -> None:
    history = _history()
    strangers = _met(history)
    _goes_on(history, 10, pan)
    carried = BESIDE.moved_to(BESIDE.cx + 10 * pan, BESIDE.cy)
    gone = TARGET.moved_to(-400.0, 100.0)
    assert strangers.refuse(carried, gone, 10 * STEP_S, history)
    assert not strangers.refuse(BESIDE, gone, 10 * STEP_S, history)


def test_a_stranger_that_walks_is_followed_while_the_target_is_away() -> None:
    history = _history()
    strangers = _met(history)
    gone = TARGET.moved_to(-400.0, 100.0)
    for number in range(1, 31):
        _goes_on(history, 1)
        walked = BESIDE.moved_to(BESIDE.cx + 5.0 * number, BESIDE.cy)
        assert strangers.refuse(walked, gone, number * STEP_S, history)


def test_a_stranger_is_forgotten_after_two_seconds() -> None:
    history = _history()
    strangers = _met(history)
    _goes_on(history, 70)
    strangers.meet([], history)
    assert not strangers.refuse(BESIDE, TARGET.moved_to(-400.0, 100.0), 2.3, history)
