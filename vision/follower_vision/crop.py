"""Cut a rectangle with real-valued edges out of an image, at another size."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from follower_vision.box import Box
from follower_vision.frame import Image


def crop(image: Image, region: Box, width: int, height: int, fill: Sequence[float]) -> Image:
    """Return `region` of an image at `width` x `height` pixels, by bilinear interpolation.

    Args:
        image: (H, W, 3) uint8.
        region: what to cut, in the image's pixels; what lies outside the image becomes `fill`.
        width: of the result, in pixels.
        height: of the result, in pixels.
        fill: three channel values, 0 to 255.
    """
    across, down = region.width / width, region.height / height
    # OpenCV counts from the middle of the first pixel, a box from its corner: hence the halves.
    to_image = np.array(
        [
            [across, 0.0, region.left + 0.5 * across - 0.5],
            [0.0, down, region.top + 0.5 * down - 0.5],
        ]
    )
    cut = cv2.warpAffine(
        image,
        to_image,
        (width, height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=tuple(fill),
    )
    return np.asarray(cut, dtype=np.uint8)
