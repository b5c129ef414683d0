"""Cut a region out of an image at a fixed size, its border pixels repeated outwards."""

from __future__ import annotations

import math

import cv2
import numpy as np

from follower_vision.box import Box
from follower_vision.frame import Image


def cut(image: Image, region: Box, width: int, height: int) -> Image:
    """Return `region` of `image` scaled to `width` x `height` pixels.

    Regions more than twice as large as the result are averaged first, so that shrinking does not
    alias. What lies outside the image repeats its border.
    """
    shrink = int(min(region.width / width, region.height / height))
    if shrink >= 2:
        image, region = _shrunk(image, region, min(4, shrink & ~1))
    return _warped(image, region, width, height)


def _shrunk(image: Image, region: Box, shrink: int) -> tuple[Image, Box]:
    """The part of the image under `region`, averaged in blocks, and the region in it."""
    left, right = _span(region.left, region.right, image.shape[1], shrink)
    top, bottom = _span(region.top, region.bottom, image.shape[0], shrink)
    size = ((right - left) // shrink, (bottom - top) // shrink)
    small = cv2.resize(image[top:bottom, left:right], size, interpolation=cv2.INTER_AREA)
    inside = Box(
        (region.cx - left) / shrink,
        (region.cy - top) / shrink,
        region.width / shrink,
        region.height / shrink,
    )
    return np.asarray(small, np.uint8), inside


def _span(low: float, high: float, size: int, shrink: int) -> tuple[int, int]:
    """Pixels `first` to `last` that cover [low, high] with a margin, whole blocks, in the image."""
    margin = 2 * shrink
    first = min(max(0, math.floor(low) - margin), max(0, size - shrink))
    last = max(min(size, math.ceil(high) + margin), first + shrink)
    return first, first + (last - first) // shrink * shrink


def _warped(image: Image, region: Box, width: int, height: int) -> Image:
    """Bilinear interpolation; a pixel's centre is at (column + 0.5, row + 0.5)."""
    across, down = region.width / width, region.height / height
    to_image = np.array(
        [
            [across, 0.0, region.left + 0.5 * across - 0.5],
            [0.0, down, region.top + 0.5 * down - 0.5],
        ]
    )
    warped = cv2.warpAffine(
        image,
        to_image,
        (width, height),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(warped, np.uint8)
