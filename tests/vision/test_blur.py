"""Blur lowers a target's sharpness against its own recent past."""

import cv2
import numpy as np
import pytest

from follower_vision.appearance.blur import BlurDetector, sharpness
from follower_vision.geometry.box import Box

BOX = Box(160, 120, 60, 40)


def texture(seed: int = 0, width: int = 320, height: int = 240) -> np.ndarray:
    small = np.random.default_rng(seed).integers(0, 255, (height // 4, width // 4, 3), np.uint8)
    return cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)


def moved(image: np.ndarray, pixels: int) -> np.ndarray:
    return cv2.blur(image, (pixels, 1))


def test_blur_lowers_sharpness_monotonically():
    values = [sharpness(moved(texture(), pixels), BOX) for pixels in (1, 3, 7, 15)]
    assert values == sorted(values, reverse=True)
    assert values[-1] < 0.2 * values[0]


def test_sharpness_does_not_depend_on_the_boxs_size():
    """The paper's sum grows with the area; ours is per pixel."""
    small, large = (sharpness(texture(), Box(160, 120, side, side)) for side in (30, 60))
    assert small == pytest.approx(large, rel=0.3)


def test_a_blurred_frame_among_sharp_ones_is_recognised():
    detector = BlurDetector()
    for index in range(30):
        assert not detector.update(texture(), BOX, index / 30).blurred
    reading = detector.update(moved(texture(), 15), BOX, 1.0)
    assert reading.blurred
    assert reading.relative < 0.4
    assert not detector.update(texture(), BOX, 1.03).blurred


def test_a_plain_scene_is_not_blurred_just_because_it_is_plain():
    detector = BlurDetector()
    plain = moved(texture(), 15)
    assert not any(detector.update(plain, BOX, index / 30).blurred for index in range(60))


@pytest.mark.parametrize("rate_hz", [10, 60])
def test_a_lasting_change_becomes_usual_within_a_second_at_any_rate(rate_hz):
    detector = BlurDetector()
    for index in range(2 * rate_hz):
        detector.update(texture(), BOX, index / rate_hz)
    readings = [
        detector.update(moved(texture(), 15), BOX, 2 + index / rate_hz)
        for index in range(round(1.2 * rate_hz))
    ]
    assert readings[0].blurred
    assert not readings[-1].blurred


def test_there_is_no_verdict_without_a_past():
    reading = BlurDetector().update(moved(texture(), 15), BOX, 0.0)
    assert (reading.relative, reading.blurred) == (1.0, False)


def test_reset_forgets_the_past():
    detector = BlurDetector()
    for index in range(30):
        detector.update(texture(), BOX, index / 30)
    detector.reset()
    assert not detector.update(moved(texture(), 15), BOX, 1.0).blurred


@pytest.mark.parametrize("box", [Box(-500, 0, 10, 10), Box(0, 0, 1, 1), Box(160, 120, 5000, 5000)])
def test_odd_boxes_give_finite_sharpness(box):
    assert np.isfinite(sharpness(texture(), box))
