"""Detects blank frames and a frozen camera."""

import math
from enum import StrEnum

import cv2
import numpy as np

from follower_vision.images.frame import Frame, Image

_ABOUT_BYTES = 1 << 16
_FROZEN_AFTER_S = 0.1
"""A picture that has not changed for so long, and was repeated at least twice, is frozen."""
_BLANK_DEVIATION = 4.0
"""A frame whose blue, green and red levels deviate less than this is blank."""
_CELL_PX, _THING_LEVELS = 8, 24.0
"""But for a thing that makes the mean of so large a square differ so much, which no noise does."""


class FrameHealth(StrEnum):
    """Whether there is anything to be seen in a frame."""

    GOOD = "good"
    BLANK = "blank"
    """Nothing but one colour: lens cap, black, white or green frames."""
    FROZEN = "frozen"
    """Exactly the picture of a while ago; a living camera has noise and never repeats itself."""


class FrameCheck:
    """Checks a sample of every frame's pixels, and all where that is the last one's or one colour.

    A small target on a still background, or before an even sky, may be between the sample's rows.
    """

    def __init__(self) -> None:
        self._sample: bytes | None = None
        self._image: Image | None = None
        self._changed_s = 0.0
        self._repeats = 0

    def update(self, frame: Frame) -> FrameHealth:
        """Judge the next frame; call it for every frame, in order."""
        # Whole rows: they lie together in memory.
        step = min(frame.height, max(1, frame.image.nbytes // _ABOUT_BYTES))
        sample = frame.image[step // 2 :: step].tobytes()
        last = self._image
        if last is not None and sample == self._sample and np.array_equal(frame.image, last):
            self._repeats += 1
        else:
            self._repeats, self._changed_s = 0, frame.captured_s
        self._sample, self._image = sample, frame.image
        rows = np.frombuffer(sample, np.uint8).reshape(-1, 1, 3)
        if _is_plain(rows) and _is_plain(frame.image) and not _has_a_thing(frame.image):
            return FrameHealth.BLANK
        still_s = frame.captured_s - self._changed_s
        if self._repeats >= 2 and still_s >= _FROZEN_AFTER_S:
            return FrameHealth.FROZEN
        return FrameHealth.GOOD


def _is_plain(pixels: Image) -> bool:
    _, deviation = cv2.meanStdDev(pixels)
    return float(deviation.max()) < _BLANK_DEVIATION


def _has_a_thing(image: Image) -> bool:
    height, width = (math.ceil(side / _CELL_PX) for side in image.shape[:2])
    cells = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    return bool(np.abs(cells - np.median(cells, axis=(0, 1))).max() > _THING_LEVELS)
