"""The target is recognised by its looks; others of its kind and colour are not."""

from copy import deepcopy
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from follower_vision.appearance.appearance import (
    Appearance,
    AppearanceGallery,
    colour_histogram,
    intersections,
)
from follower_vision.appearance.reidentify import EPSILON, MOST_TEMPLATES, Reidentifier
from follower_vision.geometry.box import Box


def patch(seed: int, colour: tuple[int, int, int], side: int = 40) -> np.ndarray:
    rng = np.random.default_rng(seed)
    shade = cv2.resize(rng.uniform(0.3, 1.3, (5, 5)), (side, side), interpolation=cv2.INTER_CUBIC)
    return np.clip(shade[..., None] * colour, 0, 255).astype(np.uint8)


def scene(*things: tuple[Box, np.ndarray], seed: int = 9) -> np.ndarray:
    rng = np.random.default_rng(seed)
    image = np.clip(rng.normal(110, 12, (240, 320, 3)), 0, 255).astype(np.uint8)
    for box, look in things:
        x, y, w, h = (round(v) for v in box.xywh)
        image[y : y + h, x : x + w] = cv2.resize(look, (w, h), interpolation=cv2.INTER_AREA)
    return image


RED, BLUE = (40, 50, 220), (220, 90, 40)
HERE, THERE = Box(80, 80, 40, 40), Box(220, 150, 40, 40)


def learnt() -> Reidentifier:
    return deepcopy(learnt_once())


@cache
def learnt_once() -> Reidentifier:
    known = Reidentifier()
    for index in range(30):
        image = scene((HERE, patch(1, RED)), seed=index)
        if index == 0:
            known.start(image, HERE, 0.0)
        known.learn(image, HERE, index / 30)
    return known


def test_the_target_itself_scores_near_two_and_is_accepted_elsewhere():
    image = scene((THERE, patch(1, RED)))
    assert learnt().score(image, THERE) > 1.7


@pytest.mark.parametrize("factor", [0.6, 1.6])
def test_another_size_is_still_the_target(factor):
    box = THERE.scaled(factor)
    assert learnt().score(scene((box, patch(1, RED))), box) > 1.4


def test_a_slightly_misplaced_candidate_is_still_the_target():
    image = scene((THERE, patch(1, RED)))
    assert learnt().score(image, THERE.moved_to(THERE.cx + 4, THERE.cy - 3)) > 1.3


def test_the_same_shape_in_another_colour_and_another_shape_in_the_same_colour_are_not():
    known = learnt()
    assert known.score(scene((THERE, patch(1, BLUE))), THERE) < 1.2
    assert known.score(scene((THERE, patch(2, RED))), THERE) < known.score(
        scene((THERE, patch(1, RED))), THERE
    )


def test_the_best_of_several_is_chosen_and_only_above_epsilon():
    known = learnt()
    image = scene((HERE, patch(2, BLUE)), (THERE, patch(1, RED)))
    box, score = known.best(image, [HERE, THERE, Box(160, 40, 40, 40)])
    assert box == THERE
    assert score >= EPSILON == 1.2
    assert known.best(image, [HERE]) is None
    assert known.best(image, []) is None


def test_grey_images_are_compared_as_well():
    grey = np.repeat(scene((HERE, patch(1, RED)))[..., 2:], 3, axis=2)
    known = Reidentifier()
    known.start(grey, HERE, 0.0)
    other = np.repeat(scene((HERE, patch(3, RED)))[..., 2:], 3, axis=2)
    assert known.score(grey, HERE) > 1.9
    assert known.score(other, HERE) < known.score(grey, HERE) - 0.3


@pytest.mark.parametrize("rate_hz", [5, 30, 120])
def test_templates_are_of_the_first_second_and_bounded_at_any_rate(rate_hz):
    known, image = Reidentifier(), scene((HERE, patch(1, RED)))
    known.start(image, HERE, 10.0)
    taken = [
        time_s
        for time_s in 10 + np.arange(3 * rate_hz) / rate_hz
        if known.learn(image, HERE, float(time_s))
    ]
    assert len(known.templates) <= MOST_TEMPLATES
    assert len(known.templates) >= 4
    assert max(taken) <= 11.0


def test_a_new_start_forgets_the_old_target():
    known = learnt()
    known.start(scene((HERE, patch(5, BLUE))), HERE, 5.0)
    assert len(known.templates) == 1
    assert known.score(scene((THERE, patch(1, RED))), THERE) < 1.2


def correlation(template: np.ndarray, picture: np.ndarray) -> float:
    """Return the likeness of two grey pictures without a colour in common."""
    one, other = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    return AppearanceGallery([Appearance(template, one)]).likeness(Appearance(picture, other))


def test_what_has_no_structure_correlates_with_nothing():
    flat, ramp = np.full((10, 10), 90, np.uint8), np.arange(100, dtype=np.uint8).reshape(10, 10)
    assert correlation(flat, np.full((12, 12), 90, np.uint8)) == 0
    assert correlation(flat, np.pad(ramp, 1)) == 0
    assert correlation(ramp, np.pad(ramp, 2, "edge")) == pytest.approx(1, abs=1e-5)
    assert correlation(ramp[::-1, ::-1], ramp) == pytest.approx(-1, abs=1e-5)


@given(st.integers(0, 2**32 - 1), st.integers(4, 30), st.integers(4, 30))
@settings(max_examples=30)
def test_histograms_are_shares_and_intersect_fully_with_themselves(seed, height, width):
    image = np.random.default_rng(seed).integers(0, 255, (height, width, 3), np.uint8)
    shares = colour_histogram(image)
    assert shares.sum() == pytest.approx(1)
    assert shares.min() >= 0
    assert intersections([shares], shares)[0] == pytest.approx(1)


@pytest.mark.parametrize(
    "box", [Box(-100, -100, 20, 20), Box(0, 0, 1, 1), Box(160, 120, 900, 900), Box(10, 5, 300, 2)]
)
def test_odd_candidates_get_a_finite_score(box):
    assert -1 <= learnt().score(scene(), box) <= 2


def test_scoring_before_learning_is_an_error():
    with pytest.raises(RuntimeError, match="learnt"):
        Reidentifier().score(scene(), HERE)
