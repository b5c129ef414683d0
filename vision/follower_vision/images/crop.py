"""Cut a rectangle with real-valued edges out of an image, at another size."""

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image


def crop(
    image: Image, region: Box, width: int, height: int, fill: Sequence[float] | None = None
) -> Image:
    """Return `region` of an image at `width` x `height` pixels, by bilinear interpolation.

    Args:
        image: (H, W, 3) uint8.
        region: what to cut, in the image's pixels.
        width: of the result, in pixels.
        height: of the result, in pixels.
        fill: what lies outside the image, three channel values, 0 to 255; None repeats its border.
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
        borderMode=cv2.BORDER_REPLICATE if fill is None else cv2.BORDER_CONSTANT,
        borderValue=tuple(fill or ()),
    )
    return np.asarray(cut, dtype=np.uint8)


def halved(image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return the means of 2 x 2 pixels, (H // 2, W // 2[, 3]); the image has two rows and columns.

    An odd last row or column is left out.
    """
    tall, wide = image.shape[0] // 2, image.shape[1] // 2
    even = image[: 2 * tall, : 2 * wide]
    return np.asarray(cv2.resize(even, (wide, tall), interpolation=cv2.INTER_AREA), np.uint8)
