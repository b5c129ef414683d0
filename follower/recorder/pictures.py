"""Images into pictures of a video codec and back, the same way on both sides."""

from __future__ import annotations

import av
import cv2
import numpy as np

from follower_vision.frame import Image

LOSSLESS_FORMAT, LOSSY_FORMAT = "bgr24", "yuv420p"


def to_picture(image: Image, lossless: bool) -> av.VideoFrame:
    """Return the image as the encoder takes it; of an odd size it is grown by a row or column."""
    if lossless:
        return av.VideoFrame.from_numpy_buffer(np.ascontiguousarray(image), format=LOSSLESS_FORMAT)
    planes = np.asarray(cv2.cvtColor(_even(image), cv2.COLOR_BGR2YUV_I420), np.uint8)
    return av.VideoFrame.from_numpy_buffer(planes, format=LOSSY_FORMAT)


def to_image(picture: av.VideoFrame, width: int, height: int) -> Image:
    """Return a decoded picture as (height, width, 3) BGR."""
    if picture.format.name == LOSSY_FORMAT:
        image = cv2.cvtColor(picture.to_ndarray(), cv2.COLOR_YUV2BGR_I420)
    else:
        image = picture.to_ndarray(format=LOSSLESS_FORMAT)
    return np.ascontiguousarray(image[:height, :width], np.uint8)


def _even(image: Image) -> Image:
    down, right = image.shape[0] % 2, image.shape[1] % 2
    if not down and not right:
        return image
    return np.asarray(cv2.copyMakeBorder(image, 0, down, 0, right, cv2.BORDER_REPLICATE), np.uint8)
