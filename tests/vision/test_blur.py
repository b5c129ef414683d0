"""Blur is told by a target's sharpness against its own recent past."""

import cv2
import numpy as np
import pytest

from follower_vision.appearance.blur import BlurDetector
from follower_vision.geometry.box import Box

BOX = Box(160, 120, 60, 40)


def texture(seed: int = 0, width: int = 320, height: int = 240) -> np.ndarray:
    small = np.random.default_rng(seed).integers(0, 255, (height // 4, width // 4, 3), np.uint8)
    return cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)


def moved(image: np.ndarray, pixels: int) -> np.ndarray:
    return cv2.blur(image, (pixels, 1))


def seen_after(usual: np.ndarray, image: np.ndarray, box: Box = BOX) -> bool:
    """Whether an image counts as blurred after a second of the usual one."""
    detector = BlurDetector()
    for index in range(30):
        detector.update(usual, box, index / 30)
    return detector.update(image, box, 1.0)


def test_the_more_blur_the_surer():
    verdicts = [seen_after(texture(), moved(texture(), pixels)) for pixels in (1, 2, 3, 5, 7, 15)]
    assert verdicts == sorted(verdicts)
    assert (verdicts[0], verdicts[-1]) == (False, True)


def test_it_does_not_depend_on_the_boxs_size():
    """The paper's sum grows with the area; ours is per pixel."""
    detector = BlurDetector()
    for index in range(30):
        detector.update(texture(), Box(160, 120, 60, 60), index / 30)
    assert not detector.update(texture(), Box(160, 120, 30, 30), 1.0)


def test_a_blurred_frame_among_sharp_ones_is_recognised():
    detector = BlurDetector()
    for index in range(30):
        assert not detector.update(texture(), BOX, index / 30)
    assert detector.update(moved(texture(), 15), BOX, 1.0)
    assert not detector.update(texture(), BOX, 1.03)


def test_a_plain_scene_is_not_blurred_just_because_it_is_plain():
    detector = BlurDetector()
    plain = moved(texture(), 15)
    assert not any(detector.update(plain, BOX, index / 30) for index in range(60))


@pytest.mark.parametrize("rate_hz", [10, 60])
def test_a_lasting_change_becomes_usual_within_a_second_at_any_rate(rate_hz):
    detector = BlurDetector()
    for index in range(2 * rate_hz):
        detector.update(texture(), BOX, index / rate_hz)
    readings = [
        detector.update(moved(texture(), 15), BOX, 2 + index / rate_hz)
        for index in range(round(1.2 * rate_hz))
    ]
    assert readings[0]
    assert not readings[-1]


def test_there_is_no_verdict_without_a_past():
    assert not BlurDetector().update(moved(texture(), 15), BOX, 0.0)


@pytest.mark.parametrize("box", [Box(-500, 0, 10, 10), Box(0, 0, 1, 1), Box(160, 120, 5000, 5000)])
def test_odd_boxes_are_never_blurred(box):
    assert not seen_after(texture(), texture(), box)
