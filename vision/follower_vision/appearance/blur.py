"""Detects blur in the target's neighbourhood.

After Panda and Barczyk, "Blending of Learning-based Tracking and Object Detection for Monocular
Camera-based Target Following" (IFAC 2019): the variance of the Laplacian on a region of twice the
box's width and height. Departures: low variance means blurred (the paper's listing says high);
the variance is divided by the number of pixels (the paper's is a sum, which grows with the box);
and it is compared with what the same target's neighbourhood had lately, because a sharp image of a
plain wall has less of it than a blurred image of a forest.
"""

import math
from collections import deque
from statistics import median

import cv2
import numpy as np

from follower_vision.geometry.box import Box
from follower_vision.images.crop import halved
from follower_vision.images.frame import Image

_REGION = 2.0
_MOST_PIXELS = 160.0 * 160.0
_BLURRED_RATIO = 0.4
"""Blurred below this share of the recent median sharpness."""
_WINDOW_S = 1.0
"""How far back "recent" reaches."""
_LEAST_HISTORY_S = 0.15
"""No verdict before the history is so long."""
_MOST_REMEMBERED = 256  # where time stands still


class BlurDetector:
    """Compares a target's sharpness with its own of the last second."""

    def __init__(self) -> None:
        self._history: deque[tuple[float, int, float]] = deque(maxlen=_MOST_REMEMBERED)

    def update(self, image: Image, box: Box, captured_s: float) -> bool:
        """Return whether the neighbourhood of `box` is blurred in this frame, and remember it.

        Args:
            image: (H, W, 3) uint8 BGR, or (H, W) grey.
            box: the target, or where it is believed to be.
            captured_s: the frame's capture time in seconds, later than the last one's.
        """
        region = _neighbourhood(image, box)
        halvings = _halvings(region)
        value = _sharpness(region, halvings)
        usual = self._usual(halvings, captured_s)
        self._history.append((captured_s, halvings, value))
        return usual is not None and value < _BLURRED_RATIO * usual

    def _usual(self, halvings: int, now_s: float) -> float | None:
        """The recent median, of the same reduction: those of others do not compare."""
        history = self._history
        while history and history[0][0] < now_s - _WINDOW_S:
            history.popleft()
        known = [(then_s, past) for then_s, count, past in history if count == halvings]
        if not known or now_s - known[0][0] < _LEAST_HISTORY_S:
            return None
        return median(past for _, past in known)


def _neighbourhood(image: Image, box: Box) -> Image:
    """The part of the image within twice the box's width and height; a view."""
    height, width = image.shape[:2]
    around = box.scaled(_REGION)
    left, right = max(0, math.floor(around.left)), min(width, math.ceil(around.right))
    top, bottom = max(0, math.floor(around.top)), min(height, math.ceil(around.bottom))
    return image[top : max(top, bottom), left : max(left, right)]


def _halvings(region: Image) -> int:
    """How often a region has to be halved to be of bounded size, and so of bounded time."""
    pixels, count = region.shape[0] * region.shape[1], 0
    while pixels > _MOST_PIXELS:
        pixels, count = pixels // 4, count + 1
    return count


def _sharpness(region: Image, halvings: int) -> float:
    """The variance of the Laplacian per pixel, in squared grey levels; 0 of what is too small."""
    if min(region.shape[:2]) < 3 << halvings:
        return 0.0
    grey = region if region.ndim == 2 else cv2.cvtColor(region, cv2.COLOR_BGR2GRAY)
    grey = np.asarray(grey, np.uint8)
    for _ in range(halvings):
        grey = halved(grey)
    _, deviation = cv2.meanStdDev(cv2.Laplacian(grey, cv2.CV_16S))
    return float(np.square(deviation[0, 0]))
