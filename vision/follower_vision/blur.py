"""Tells when the target's neighbourhood is blurred.

After Panda and Barczyk, "Blending of Learning-based Tracking and Object Detection for Monocular
Camera-based Target Following" (IFAC 2019): the variance of the Laplacian on a region of twice the
box's width and height. Departures: low variance means blurred (the paper's listing says high);
the variance is divided by the number of pixels (the paper's is a sum, which grows with the box);
and it is compared with what the same target's neighbourhood had lately, because a sharp image of a
plain wall has less of it than a blurred image of a forest.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from statistics import median
from typing import Any, ClassVar

import cv2
import numpy as np

from follower_vision.box import Box
from follower_vision.frame import Image

_REGION = 2.0
_MOST_PIXELS = 160.0 * 160.0


@dataclass(frozen=True, slots=True)
class BlurSettings:
    """When a neighbourhood counts as blurred.

    Attributes:
        ratio: blurred below this share of the recent median sharpness.
        window_s: how far back "recent" reaches.
        least_history_s: no verdict before the history is this long.
    """

    ratio: float = 0.4
    window_s: float = 1.0
    least_history_s: float = 0.15

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    def __post_init__(self) -> None:
        if not 0 < self.ratio < 1:
            raise ValueError(f"blur: ratio lies between 0 and 1, not {self.ratio:g}")
        if not 0 <= self.least_history_s < self.window_s < math.inf:
            raise ValueError("blur: least_history_s has to be shorter than window_s")


@dataclass(frozen=True, slots=True)
class BlurReading:
    """How sharp a neighbourhood is.

    Attributes:
        sharpness: variance of the Laplacian per pixel, in squared grey levels.
        relative: the same as a share of the recent median; 1 while there is no history.
        blurred: the verdict.
    """

    sharpness: float
    relative: float
    blurred: bool


class BlurDetector:
    """Compares a target's sharpness with its own of the last second."""

    def __init__(self, settings: BlurSettings | None = None) -> None:
        self._settings = settings or BlurSettings()
        self._history: deque[tuple[float, float]] = deque()

    def reset(self) -> None:
        """Forget the history: another target, or the same one found again elsewhere."""
        self._history.clear()

    def update(self, image: Image, box: Box, captured_s: float) -> BlurReading:
        """Judge the neighbourhood of `box` in a frame and remember it.

        Args:
            image: (H, W, 3) uint8 BGR.
            box: the target, or where it is believed to be.
            captured_s: the frame's capture time in seconds, later than the last one's.
        """
        value = sharpness(image, box)
        relative = self._relative(value, captured_s)
        self._history.append((captured_s, value))
        return BlurReading(value, relative, relative < self._settings.ratio)

    def _relative(self, value: float, now_s: float) -> float:
        history = self._history
        while history and history[0][0] < now_s - self._settings.window_s:
            history.popleft()
        if not history or now_s - history[0][0] < self._settings.least_history_s:
            return 1.0
        usual = median(past for _, past in history)
        return value / usual if usual > 0 else 1.0


def sharpness(image: Image, box: Box) -> float:
    """Return the variance of the Laplacian per pixel on twice the box's width and height.

    Regions of more than 160 x 160 pixels are reduced to that many, to bound the time. A region
    wholly outside the image has no sharpness: 0.

    Args:
        image: (H, W, 3) uint8 BGR.
        box: in the image's pixels; the part of its neighbourhood inside the image counts.
    """
    height, width = image.shape[:2]
    around = box.scaled(_REGION)
    left, right = max(0, math.floor(around.left)), min(width, math.ceil(around.right))
    top, bottom = max(0, math.floor(around.top)), min(height, math.ceil(around.bottom))
    if right - left < 3 or bottom - top < 3:
        return 0.0
    grey = cv2.cvtColor(image[top:bottom, left:right], cv2.COLOR_BGR2GRAY)
    factor = math.sqrt(_MOST_PIXELS / grey.size)
    if factor < 1:
        grey = cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    _, deviation = cv2.meanStdDev(cv2.Laplacian(grey, cv2.CV_32F))
    return float(np.square(deviation[0, 0]))
