"""Look-alikes are followed beside the target, each with its probability of being it."""

from __future__ import annotations

import numpy as np
import pytest

from follower_vision.fusion.candidates import corners_of
from follower_vision.fusion.distractors import Distractors
from follower_vision.geometry.box import Box

TARGET = Box(100, 100, 20, 30)
INTERVAL_S = 1 / 30
NO_FEATURES = np.zeros((1, 0))


def other(x: float) -> Box:
    return Box(x, 100, 20, 30)


def watch(
    known: Distractors,
    boxes: list[Box],
    probability: float = 0.3,
    target: Box = TARGET,
    deviations: float = 0.0,
) -> None:
    known.predict(INTERVAL_S)
    every, features = np.full(len(boxes), probability), np.zeros((len(boxes), 0))
    known.update(target, boxes, every, features, np.full(len(boxes), deviations))


def overlaps(known: Distractors, *boxes: Box) -> tuple[list[float], list[float], list[float]]:
    overlap, age, probability, _ = known.beside(corners_of(list(boxes)))
    return overlap.tolist(), age.tolist(), probability.tolist()


def test_nobody_is_known_at_first() -> None:
    known = Distractors()
    assert overlaps(known, TARGET) == ([0], [0], [0])
    assert known.likeness(np.ones((2, 3))).tolist() == [0, 0]


def test_who_stands_beside_the_target_is_known_and_the_target_is_not() -> None:
    known = Distractors()
    for _ in range(15):
        watch(known, [TARGET, other(160)])
    overlap, age, probability = overlaps(known, TARGET, other(160))
    assert overlap == pytest.approx([0, 1])
    assert age == pytest.approx([0, 14 * INTERVAL_S])
    assert probability == pytest.approx([0, 0.3])


def test_what_came_from_where_the_target_was_not_is_known_for_it_all_the_way() -> None:
    known = Distractors()
    for number in range(20):
        watch(known, [other(160 + 2.0 * number)], deviations=max(4.0 - 0.5 * number, 0.2))
    assert known.beside(corners_of([other(198), TARGET]))[3].tolist() == [4.0, 0.0]
    for _ in range(10):
        watch(known, [])
    watch(known, [other(198)])
    assert known.beside(corners_of([other(198)]))[3].tolist() == [0.0], "out of sight it is lost"


def test_it_is_expected_where_its_way_leads_while_it_is_hidden() -> None:
    known = Distractors()
    for number in range(40):
        watch(known, [other(160 + 2.0 * number)])
    for _ in range(5):
        watch(known, [])
    (overlap,), _, _ = overlaps(known, other(160 + 2.0 * 44))
    assert overlap > 0.9


def test_hidden_for_long_it_is_forgotten() -> None:
    known = Distractors()
    watch(known, [other(160)])
    for _ in range(8):
        watch(known, [])
    assert overlaps(known, other(160))[0] == [1]
    watch(known, [])
    assert overlaps(known, other(160))[0] == [0]


def test_its_probability_is_the_mean_of_the_last_third_of_a_second() -> None:
    known = Distractors()
    for _ in range(60):
        watch(known, [other(160)], 0.2)
    (before,) = overlaps(known, other(160))[2]
    for _ in range(10):
        watch(known, [other(160)], 0.8)
    (after,) = overlaps(known, other(160))[2]
    assert before == pytest.approx(0.2)
    assert after == pytest.approx(0.2 + 0.6 * (1 - np.exp(-1)), abs=0.01)


def test_what_becomes_the_target_is_no_distractor_any_more() -> None:
    known = Distractors()
    watch(known, [other(160)])
    watch(known, [TARGET], target=other(160))
    assert overlaps(known, other(160), TARGET)[0] == pytest.approx([0, 1])


def test_two_that_overlap_are_one_and_six_are_the_most() -> None:
    known = Distractors()
    watch(known, [other(160), other(164)])
    assert len(known._tracks) == 1
    for _ in range(3):
        watch(known, [other(160 + 40 * k) for k in range(9)])
    assert len(known._tracks) == 6


def test_each_is_told_by_its_features_as_they_were_seen_last() -> None:
    known, one, two = Distractors(), np.array([[1.0, 0.0]]), np.array([[0.0, 1.0]])
    for features in (one, two, np.zeros((1, 2))):
        known.predict(INTERVAL_S)
        known.update(TARGET, [other(160)], np.array([0.3]), features, np.zeros(1))
    assert known.likeness(np.vstack([one, two])).tolist() == [0.0, 1.0]


@pytest.mark.parametrize("rate_hz", [10.0, 30.0, 100.0])
def test_how_long_it_is_known_is_counted_in_seconds(rate_hz: float) -> None:
    known = Distractors()
    for _ in range(round(0.5 * rate_hz) + 1):
        known.predict(1 / rate_hz)
        known.update(TARGET, [other(160)], np.array([0.3]), NO_FEATURES, np.zeros(1))
    assert overlaps(known, other(160))[1] == pytest.approx([0.5])
