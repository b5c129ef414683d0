"""Images into pictures of a video codec and back, the same way on both sides."""

from __future__ import annotations

from fractions import Fraction

import av
import cv2
import numpy as np

from follower_vision.frame import Image

LOSSLESS_FORMAT, LOSSY_FORMAT = "bgr24", "yuv420p"
TICK = Fraction(1, 1000)
"""Seconds. Matroska's own resolution; the exact capture times are in the log."""


class PictureTimes:
    """At which tick of a video each of its pictures stands: the first at 0, no two at one."""

    def __init__(self) -> None:
        self._origin_s: float | None = None
        self._tick = -1

    def of(self, captured_s: float) -> int:
        """Return the next picture's, by the frame's capture time."""
        if self._origin_s is None:
            self._origin_s = captured_s
        self._tick = max(self._tick + 1, round((captured_s - self._origin_s) / TICK))
        return self._tick


def to_picture(image: Image, lossless: bool) -> av.VideoFrame:
    """Return the image as the encoder takes it; for H.264 it is grown to multiples of 4 pixels."""
    if lossless:
        return av.VideoFrame.from_numpy_buffer(np.ascontiguousarray(image), format=LOSSLESS_FORMAT)
    planes = np.asarray(cv2.cvtColor(_grown(image), cv2.COLOR_BGR2YUV_I420), np.uint8)
    return av.VideoFrame.from_numpy_buffer(planes, format=LOSSY_FORMAT)


def to_image(picture: av.VideoFrame, width: int, height: int) -> Image:
    """Return a decoded picture as (height, width, 3) BGR."""
    if picture.format.name == LOSSY_FORMAT:
        image = cv2.cvtColor(picture.to_ndarray(), cv2.COLOR_YUV2BGR_I420)
    else:
        image = picture.to_ndarray(format=LOSSLESS_FORMAT)
    return np.ascontiguousarray(image[:height, :width], np.uint8)


def lossy_size(width: int, height: int) -> tuple[int, int]:
    """Return the size that an image has in H.264: OpenCV and PyAV agree on multiples of 4."""
    return width + -width % 4, height + -height % 4


def _grown(image: Image) -> Image:
    down, right = -image.shape[0] % 4, -image.shape[1] % 4
    if not down and not right:
        return image
    return np.asarray(cv2.copyMakeBorder(image, 0, down, 0, right, cv2.BORDER_REPLICATE), np.uint8)
