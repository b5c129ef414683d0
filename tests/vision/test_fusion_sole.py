"""A lost target that no longer looks like itself, but is the only candidate there is."""

from __future__ import annotations

from follower_vision.box import Box
from follower_vision.fusion.history import History, Moment
from follower_vision.fusion.sole import Sole
from follower_vision.fusion.warp import Warp

STEP_S = 1 / 30
LOST = Box(300, 200, 60, 40)
REACH_PX = 150.0

Seen = list[tuple[float, Box]]


def _answers(looks: list[Seen], pan: float = 0.0, gap: int = 2) -> list[bool]:
    """What is said after each look, one every `gap` frames."""
    sole, history, answers = Sole(), History(), []
    for number in range(gap * len(looks)):
        moment: Moment = history.add(number * STEP_S, Warp(right=pan if number else 0.0), LOST)
        if number % gap == 0:
            scored = looks[number // gap]
            answers.append(sole.persists(scored, moment, history, REACH_PX))
    return answers


def _walking(count: int, pace: float = 4.0, start: float = 350.0) -> list[Seen]:
    return [[(1.1, Box(start + pace * number, 210, 60, 40))] for number in range(count)]


def test_the_only_candidate_is_taken_after_five_looks() -> None:
    assert _answers(_walking(6)) == [False, False, False, False, True, True]


def test_it_is_followed_as_the_camera_swings() -> None:
    assert _answers(_walking(6, pace=24.0), pan=12.0)[-1]


def test_another_about_as_likely_leaves_it_open() -> None:
    other = (1.0, Box(100, 200, 60, 40))
    assert not any(_answers([[*look, other] for look in _walking(8)]))


def test_one_that_is_much_less_likely_does_not_count() -> None:
    other = (0.6, Box(100, 200, 60, 40))
    assert _answers([[*look, other] for look in _walking(6)])[-1]


def test_one_that_came_from_elsewhere_is_not_taken() -> None:
    assert not any(_answers(_walking(8, start=600.0)))


def test_another_at_each_look_is_not_the_same() -> None:
    places = [200.0, 330.0, 250.0, 400.0, 210.0, 330.0, 240.0, 420.0]
    assert not any(_answers([[(1.1, Box(x, 200, 60, 40))] for x in places]))


def test_a_long_gap_begins_anew() -> None:
    assert not any(_answers(_walking(8), gap=15))


def test_looks_without_anybody_do_not_end_it() -> None:
    looks = _walking(6)
    looks[2] = []
    assert _answers(looks)[-1]
