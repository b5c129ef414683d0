"""The Re3 tracker: what it shows its network, and what it makes of the answers."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_vision.geometry.box import Box
from follower_vision.trackers.re3 import (
    SEARCH_PX,
    TARGET_PX,
    Re3Memory,
    Re3Output,
    Re3Settings,
    Re3State,
    Re3Tracker,
    absolute_box,
    relative_box,
    relative_size,
    search_region,
    template_region,
)

SIDES = st.floats(4, 400)
PLACES = st.floats(-200, 800)
BOXES = st.builds(Box, PLACES, PLACES, SIDES, SIDES)


def state(value: float) -> Re3State:
    return Re3State(np.full((2, 1, 3), value, np.float32), np.zeros((2, 1, 3), np.float32))


class CountingNetwork:
    """Answers a fixed box; its state counts the frames seen since the first one."""

    def __init__(self, answer: tuple[float, float, float, float]) -> None:
        self.answer = np.array(answer, np.float32)
        self.states: list[float] = []
        self.boxes: list[Box] = []
        self.seen: list[float] = []
        self.first_state = state(0.0)

    def view(self, image, box, _fill):
        return np.full((1, 1, 3), int(image[0, 0, 0]) + box.cx, np.float32)

    def learn(self, _image, box, _fill):
        features = np.zeros((1, 4, 8, 8), np.float32)
        return Re3Memory(features, np.array([relative_size(box)], np.float32)), state(1.0)

    def predict(self, view, _image, box, _fill, memory, before):
        count = float(before.hidden[0, 0, 0])
        self.states.append(count)
        self.boxes.append(box)
        self.seen.append(float(view[0, 0, 0]))
        return Re3Output(self.answer, 0.75, memory.features, state(count + 1))


def image(grey: int = 0) -> np.ndarray:
    return np.full((480, 640, 3), grey, np.uint8)


@given(BOXES, BOXES)
def test_an_answer_means_the_box_it_was_made_of(box: Box, last: Box) -> None:
    answer = np.array(relative_box(box, last), np.float64)
    back = absolute_box(answer, last)
    assert back.cx == pytest.approx(box.cx, abs=1e-6)
    assert back.cy == pytest.approx(box.cy, abs=1e-6)
    for found, true, before in (
        (back.width, box.width, last.width),
        (back.height, box.height, last.height),
    ):
        limited = min(max(true / before, math.exp(-0.5)), math.exp(0.5))
        assert found == pytest.approx(before * limited)


@given(BOXES)
def test_crops_are_squares_about_the_box_in_which_its_scale_is_fixed(box: Box) -> None:
    search, template = search_region(box), template_region(box)
    assert search.width == search.height
    assert box.scale / search.width * SEARCH_PX == pytest.approx(TARGET_PX)
    assert template.width == pytest.approx(search.width / 2)
    assert math.prod(relative_size(box)) == pytest.approx(1.0)


def test_memory_goes_back_to_the_first_frames_every_32_frames() -> None:
    network = CountingNetwork((0, 0, 0, 0))
    tracker = Re3Tracker(network)
    tracker.start(image(), Box(320, 240, 40, 40))
    for _ in range(70):
        tracker.update(image())
    once = [float(count) for count in range(1, 33)]
    assert network.states == once + once + once[:6]


def test_the_box_goes_on_from_the_last_one() -> None:
    tracker = Re3Tracker(CountingNetwork((0.5, -0.25, math.log(1.1), 0.0)))
    tracker.start(image(), Box(100, 200, 40, 40))
    first = tracker.update(image()).box
    assert (first.cx, first.cy) == pytest.approx((120, 190))
    assert (first.width, first.height) == pytest.approx((44, 40))
    second = tracker.update(image()).box
    assert second.cx == pytest.approx(120 + 0.5 * math.sqrt(44 * 40))


@pytest.mark.parametrize("part", ["box", "confidence", "features", "state"])
def test_broken_numbers_of_the_network_are_an_unseen_frame_and_not_remembered(part: str) -> None:
    network = CountingNetwork((0.0, 0.0, 0.0, 0.0))
    tracker = Re3Tracker(network)
    tracker.start(image(), Box(100, 100, 40, 40))
    before = tracker.update(image(1)).box
    right, whole = network.predict, state(math.nan) if part == "state" else np.array(math.nan)
    network.predict = lambda *given: replace(right(*given), **{part: whole})
    estimate = tracker.update(image(2))
    assert (estimate.box, estimate.confidence) == (before, 0.0)
    network.predict = right
    assert tracker.update(image(3)).confidence > 0.9
    assert np.isfinite(network.states).all()


def test_a_likelihood_beyond_its_range_is_no_confidence_beyond_it() -> None:
    network = CountingNetwork((0.0, 0.0, 0.0, 0.0))
    tracker, right = Re3Tracker(network), network.predict
    tracker.start(image(), Box(100, 100, 40, 40))
    for wrong in (1e30, -0.1):
        network.predict = lambda *given, wrong=wrong: replace(right(*given), confidence=wrong)
        assert 0 <= tracker.update(image(1)).confidence <= 1


def test_the_box_stays_on_the_image_and_does_not_vanish() -> None:
    tracker = Re3Tracker(CountingNetwork((-3.0, 5.0, -0.5, 0.5)))
    tracker.start(image(), Box(20, 460, 10, 300))
    for _ in range(8):
        box = tracker.update(image()).box
    assert (box.cx, box.cy) == (0, 480)
    assert box.width == Re3Settings().smallest_side_px
    assert box.height == 480


def test_a_search_goes_nowhere_until_it_is_told_what_was_right() -> None:
    network = CountingNetwork((0, 0, 0, 0))
    tracker, second = Re3Tracker(network), image(2)
    tracker.start(image(), Box(100, 100, 40, 40))
    for place in (200, 300):
        response = tracker.search(second, Box(place, 100, 40, 40))
        assert response.corners.tolist() == [[place - 20, 80, place + 20, 120]]
        assert response.scores == 0.75 ** Re3Settings().confidence_power
        assert response.penalty == 1
        assert response.region.width == pytest.approx(40 * SEARCH_PX / TARGET_PX)
    tracker.learn(second, Box(250, 100, 40, 40), 0.9)
    tracker.search(image(3), Box(250, 100, 40, 40))
    assert network.seen == [100, 100, 252]
    assert network.states == [1.0, 1.0, 2.0]


def test_what_nobody_confirmed_is_not_remembered() -> None:
    network = CountingNetwork((0, 0, 0, 0))
    tracker = Re3Tracker(network)
    tracker.start(image(), Box(100, 100, 40, 40))
    tracker.search(image(1), Box(200, 100, 40, 40))
    tracker.learn(image(2), Box(200, 100, 40, 40), 0.9)  # another image than the one searched
    tracker.search(image(3), Box(200, 100, 40, 40))
    assert network.seen == [100, 100]
    assert network.states == [1.0, 1.0]
