"""Look-alikes that come together with the target and part again."""

from __future__ import annotations

import pytest

from follower_vision.box import Box
from follower_vision.fusion.rivals import Rivals
from follower_vision.motion import MotionEstimate

STEP_S = 1 / 30


def _place(x: float, y: float = 100.0, confidence: float = 0.99) -> MotionEstimate:
    return MotionEstimate(Box(x, y, 30, 60), confidence)


def _approach(rivals: Rivals, frames: int, speed: float, pan: float = 0.0) -> None:
    """A look-alike comes from the right at `speed` pixels a frame, down to 40 pixels away."""
    for number in range(frames):
        x = 300.0 + pan * number
        target, other = _place(x), _place(x + 40 + speed * (frames - 1 - number))
        rivals.advance(STEP_S)
        assert rivals.settle(target.box, target, [target, other]) is target


def _together(rivals: Rivals, frames: int, x: float) -> None:
    for _ in range(frames):
        one = _place(x)
        rivals.advance(STEP_S)
        assert rivals.settle(one.box, one, [one]) is one


@pytest.mark.parametrize("pan", [0.0, 25.0])
def test_a_look_alike_that_crosses_is_not_gone_with(pan: float) -> None:
    rivals = Rivals()
    _approach(rivals, 10, speed=8.0, pan=pan)
    _together(rivals, 9, 300.0 + 10 * pan)
    assert rivals.merged
    rivals.advance(STEP_S)
    behind, crossed = _place(340.0), _place(300.0)
    # The tracker went with the look-alike, which is to the left of the target now.
    assert rivals.settle(crossed.box, crossed, [crossed, behind]) is behind
    assert not rivals.merged


def test_a_look_alike_that_crossed_is_left_alone() -> None:
    rivals = Rivals()
    _approach(rivals, 10, speed=8.0)
    _together(rivals, 9, 300.0)
    rivals.advance(STEP_S)
    target, other = _place(300.0), _place(260.0)
    assert rivals.settle(target.box, target, [target, other]) is target


def test_a_neighbour_that_turns_back_is_no_reason_to_swap() -> None:
    rivals = Rivals()
    _approach(rivals, 10, speed=0.0)
    _together(rivals, 5, 300.0)
    rivals.advance(STEP_S)
    target, other = _place(300.0), _place(342.0)
    assert rivals.settle(target.box, target, [target, other]) is target


def test_a_jump_to_a_look_alikes_place_is_undone() -> None:
    rivals = Rivals()
    for _ in range(10):
        target = _place(300.0)
        rivals.advance(STEP_S)
        assert rivals.settle(target.box, target, [target, _place(420.0)]) is target
    jumped, left = _place(420.0), _place(300.0)
    rivals.advance(STEP_S)
    assert rivals.settle(left.box, jumped, [jumped, left]) is left
    assert not rivals.merged


def test_a_jump_to_where_nobody_was_is_believed() -> None:
    rivals = Rivals()
    for _ in range(10):
        target = _place(300.0)
        rivals.advance(STEP_S)
        rivals.settle(target.box, target, [target, _place(420.0), _place(360.0, confidence=0.3)])
    jumped, left = _place(360.0), _place(300.0)
    rivals.advance(STEP_S)
    assert rivals.settle(left.box, jumped, [jumped, left]) is jumped


def test_a_meeting_is_forgotten_when_it_lasts() -> None:
    rivals = Rivals()
    _approach(rivals, 10, speed=2.0)
    _together(rivals, 40, 300.0)
    assert not rivals.merged


def test_a_look_alike_that_hides_the_target_is_not_gone_with() -> None:
    rivals = Rivals()
    for _ in range(10):
        target = _place(300.0)
        rivals.advance(STEP_S)
        assert rivals.settle(target.box, target, [target, _place(420.0)]) is target
    assert [box.cx for box in rivals.standing] == [420.0]
    jumped, expected = _place(420.0), _place(300.0).box
    rivals.advance(STEP_S)
    hidden = rivals.settle(expected, jumped, [jumped])
    assert hidden.box == expected
    assert hidden.confidence == 0.0
    assert rivals.standing == [jumped.box]


def test_who_is_who_is_not_decided_before_they_have_parted() -> None:
    rivals = Rivals()
    _approach(rivals, 10, speed=8.0)
    _together(rivals, 5, 300.0)
    assert rivals.merged
    rivals.advance(STEP_S)
    both, part = _place(300.0), _place(280.0, confidence=0.6)
    assert rivals.settle(both.box, both, [both, part]) is both
