"""A frame that shows nothing, or the same as a while ago, is told from a living picture."""

import numpy as np
import pytest

from follower_vision.appearance.frame_check import FrameCheck, FrameHealth
from follower_vision.images.frame import Frame


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(70, 150, (480, 640, 3), np.uint8)


def test_a_living_picture_is_good_and_a_repeated_one_is_frozen_after_a_while():
    check = FrameCheck()
    for index in range(5):
        assert check.update(Frame(noise(index), index / 30, index)) is FrameHealth.GOOD
    still = noise(9)
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


@pytest.mark.parametrize("top", range(300, 342, 6))
def test_a_target_before_an_overexposed_sky_is_seen_wherever_it_is(top: int) -> None:
    image = np.full((720, 1280, 3), 255, np.uint8)
    image[top : top + 30, 600:630] = 40
    assert FrameCheck().update(Frame(image, 0.0, 0)) is FrameHealth.GOOD


@pytest.mark.parametrize("side", [8, 12, 24])
def test_a_small_target_before_an_overexposed_sky_is_no_blank_frame(side: int) -> None:
    image = np.full((720, 1280, 3), 255, np.uint8)
    image[303 : 303 + side, 605 : 605 + side] = 40
    assert FrameCheck().update(Frame(image, 0.0, 0)) is FrameHealth.GOOD


def test_a_covered_lens_is_blank_for_all_its_noise() -> None:
    rng = np.random.default_rng(3)
    image = np.abs(rng.normal(0, 3, (720, 1280, 3))).astype(np.uint8)
    image[rng.integers(0, 720, 40), rng.integers(0, 1280, 40)] = 255  # pixels that are always lit
    assert FrameCheck().update(Frame(image, 0.0, 0)) is FrameHealth.BLANK
