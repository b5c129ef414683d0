"""The parts of finding a lost target: where it would be, where it might be, what to ask of it."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_vision.appearance.frame_check import FrameCheck, FrameCheckSettings, FrameHealth
from follower_vision.appearance.template_search import ColourSearch, TemplateSearch, tiles
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.longterm.box_check import AcceptanceThreshold, LongTermSettings, refined
from follower_vision.longterm.search import TargetSearch
from follower_vision.longterm.tracker import Extrapolation

HERE, THERE = Box(100, 120, 30, 24), Box(510, 390, 30, 24)


def scene(box: Box | None, colour=(30, 90, 240), width=640, height=480, seed=0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    coarse = rng.integers(70, 150, (height // 16, width // 16, 3), np.uint8)
    image = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    if box is not None:
        x, y, w, h = (round(v) for v in box.xywh)
        image[y : y + h, x : x + w] = colour
        image[y + h // 4 : y + h // 2, x + w // 8 : x + w // 2] = [c // 4 for c in colour]
    noise = rng.normal(0, 3, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def best_iou(candidates: list[Box], truth: Box) -> float:
    return max((box.iou(truth) for box in candidates), default=0.0)


def test_a_coloured_target_is_proposed_wherever_it_is():
    search = ColourSearch()
    search.learn(scene(HERE), HERE)
    assert best_iou(search.candidates(scene(THERE, seed=1)), THERE) > 0.6
    assert search.candidates(scene(None, seed=1)) == []


def test_a_target_in_the_backgrounds_colours_is_not_searched_by_colour():
    image, search = scene(None), ColourSearch()
    search.learn(image, HERE)
    assert search.candidates(image) == []


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.25])
def test_a_view_is_found_again_at_several_sizes(factor):
    search, box = TemplateSearch(), THERE.scaled(factor)
    search.learn(scene(HERE), HERE)
    found = search.candidates(scene(box, seed=1), (500, 380), 200, (0.8, 1.0, 1.25))
    assert best_iou(found, box) > 0.5


def test_a_view_without_structure_is_not_searched():
    search, flat = TemplateSearch(), np.full((480, 640, 3), 90, np.uint8)
    search.learn(flat, HERE)
    assert search.candidates(flat, (100, 100), 200) == []


@pytest.mark.parametrize(("width", "height"), [(320, 240), (640, 480), (1280, 720), (100, 900)])
def test_tiles_cover_the_whole_image(width, height):
    covered = np.zeros((height, width), bool)
    for x, y in tiles(width, height, 240):
        covered[
            max(0, round(y - 120)) : round(y + 120), max(0, round(x - 120)) : round(x + 120)
        ] = 1
    assert covered.all()


def test_the_whole_image_is_searched_within_a_few_frames():
    """A grey target: colour is no help, so the view has to be found piece by piece."""
    grey, search = (200, 200, 200), TargetSearch()
    search.learn(scene(HERE, grey), HERE)
    seen = 0.0
    for seed in range(1, 14):
        image = scene(THERE, grey, seed=seed)
        found = search.everywhere(image, HERE, 150)
        seen = max(seen, best_iou(found, THERE))
    assert seen > 0.5
    assert len(found) <= 6


def test_coasting_follows_a_constant_velocity_and_fades():
    coasting = Extrapolation()
    for index in range(12):
        coasting.add(index / 30, Box(100 + 4 * index, 50 - 2 * index, 20, 10))
    last_s, last = coasting.last
    soon = coasting.predict(last_s + 0.05)
    assert soon.cx - last.cx == pytest.approx(120 * 0.05, rel=0.1)
    assert soon.cy - last.cy == pytest.approx(-60 * 0.05, rel=0.1)
    assert (soon.width, soon.height) == (20, 10)
    assert coasting.predict(last_s + 100).cx - last.cx == pytest.approx(120 * 0.5, rel=0.01)


def test_coasting_stands_still_without_a_past():
    coasting = Extrapolation()
    with pytest.raises(RuntimeError, match="no box"):
        coasting.predict(1.0)
    coasting.add(0.0, HERE)
    assert coasting.predict(1.0) == HERE
    coasting.reset()
    with pytest.raises(RuntimeError, match="no box"):
        _ = coasting.last


def test_a_living_picture_is_good_and_a_repeated_one_is_frozen_after_a_while():
    check = FrameCheck()
    for index in range(5):
        assert check.update(Frame(scene(None, seed=index), index / 30, index)) is FrameHealth.GOOD
    still = scene(None, seed=9)
    health = [check.update(Frame(still, 1 + index / 30, index)) for index in range(6)]
    assert health[:3] == [FrameHealth.GOOD] * 3
    assert health[4:] == [FrameHealth.FROZEN] * 2


def test_a_small_target_on_a_still_ground_is_a_living_picture():
    """A film from a fixed camera repeats its still parts exactly."""
    check, ground = FrameCheck(), np.random.default_rng(1).integers(0, 255, (1080, 1920, 3))
    for index in range(30):
        image = ground.astype(np.uint8)
        image[440:448, 200 + 4 * index : 240 + 4 * index] = 255
        assert check.update(Frame(image, index / 30, index)) is FrameHealth.GOOD


@pytest.mark.parametrize("colour", [0, 128, 255, (255, 0, 0), (0, 135, 0)])
def test_one_colour_is_blank(colour):
    image = np.full((48, 64, 3), colour, np.uint8)
    assert FrameCheck().update(Frame(image, 0.0, 0)) is FrameHealth.BLANK


def test_still_recordings_can_be_allowed():
    check, still = FrameCheck(FrameCheckSettings(frozen_after_s=float("inf"))), scene(None)
    health = {check.update(Frame(still, index / 30, index)) for index in range(60)}
    assert health == {FrameHealth.GOOD}


def test_a_rough_box_is_fitted():
    box, score = refined(HERE.scaled(0.75).moved_to(103, 118), lambda box: box.iou(HERE))
    assert score == box.iou(HERE) > 0.8


def test_fitting_is_bounded_and_never_worse():
    calls = []

    def score(box: Box) -> float:
        calls.append(box)
        return -box.area

    assert refined(HERE, score)[1] >= -HERE.area
    assert len(calls) <= 25


@given(st.one_of(st.none(), st.floats(-1, 2)), st.integers(0, 30), st.floats(0, 100))
def test_acceptance_never_asks_less_than_epsilon_nor_more_than_can_be_reached(level, fails, wait_s):
    settings = LongTermSettings()
    acceptance = AcceptanceThreshold(settings)
    for _ in range(fails):
        acceptance.fail(10.0)
    asked = acceptance.epsilon(level, 10.0 + wait_s)
    assert settings.reidentify.epsilon <= asked <= settings.most_epsilon


def test_acceptance_rises_with_look_alikes_and_failures_and_forgives():
    acceptance = AcceptanceThreshold(LongTermSettings())
    plain = acceptance.epsilon(None, 0.0)
    assert acceptance.epsilon(1.3, 0.0) > plain
    acceptance.fail(0.0)
    acceptance.fail(0.0)
    assert acceptance.epsilon(None, 0.0) == pytest.approx(plain + 0.1)
    assert acceptance.epsilon(None, 5.0) == plain
    acceptance.fail(0.0)
    acceptance.reset()
    assert acceptance.epsilon(None, 0.0) == plain
