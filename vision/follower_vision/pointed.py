"""Finds the extent of the thing at a point that somebody pointed at."""

from __future__ import annotations

import itertools
import math
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.box import Box
from follower_vision.boxgrowth import grown_to_contrast
from follower_vision.frame import Image

_REACH_SHARE = 0.25
_TOLERANCES = (4, 6, 9, 13, 18, 24, 32)
_LEAST_PX = 12
_LARGEST_SHARE = 0.5
_GROWTH_RATIO = 0.15
_BLUR_PX = 3


def box_around(image: Image, x: float, y: float) -> Box | None:
    """Return the box of the region of like colour around a point, None if none stands out.

    Regions are grown from the point in Lab with ever larger tolerance, within a quarter of the
    image around it. The one taken is the most stable: the one whose area grows least from one
    tolerance to the next, after the idea of Matas et al., "Robust wide baseline stereo from
    maximally stable extremal regions" (BMVC 2002). Ground and sky run to the border of what is
    looked at, and are no thing.

    Args:
        image: (H, W, 3) uint8 BGR.
        x: of the point, in pixels.
        y: likewise.
    """
    window, left, top = _window(image, x, y)
    if min(window.shape[:2]) < 3:
        return None
    lab = cv2.cvtColor(cv2.medianBlur(window, _BLUR_PX), cv2.COLOR_BGR2Lab)
    height, width = lab.shape[:2]
    seed = min(int(x) - left, width - 1), min(int(y) - top, height - 1)
    regions = [_region(lab, seed, tolerance) for tolerance in _TOLERANCES]
    best = _most_stable(regions, width, height)
    if best is None:
        return None
    box = Box.from_xywh(best[0] + left, best[1] + top, best[2], best[3])
    return grown_to_contrast(image, box, _GROWTH_RATIO)


def _window(image: Image, x: float, y: float) -> tuple[Image, int, int]:
    """Return the part looked at, with its left and top edges in the image."""
    height, width = image.shape[:2]
    reach = _REACH_SHARE * max(height, width)
    left, right = max(int(x - reach), 0), min(math.ceil(x + reach), width)
    top, bottom = max(int(y - reach), 0), min(math.ceil(y + reach), height)
    return np.ascontiguousarray(image[top:bottom, left:right]), left, top


def _region(
    lab: npt.NDArray[Any], seed: tuple[int, int], tolerance: int
) -> tuple[int, tuple[int, int, int, int]]:
    """Return area and x, y, width, height of what is within a tolerance of the seed's colour."""
    mask = np.zeros((lab.shape[0] + 2, lab.shape[1] + 2), np.uint8)
    flags = 4 | cv2.FLOODFILL_FIXED_RANGE | cv2.FLOODFILL_MASK_ONLY | (1 << 8)
    near = (2 * tolerance, tolerance, tolerance)
    area, _, _, (x, y, width, height) = cv2.floodFill(lab, mask, seed, 0, near, near, flags)
    return int(area), (x, y, width, height)


def _most_stable(
    regions: list[tuple[int, tuple[int, int, int, int]]], width: int, height: int
) -> tuple[int, int, int, int] | None:
    best: tuple[int, int, int, int] | None = None
    least = math.inf
    for (area, rect), (next_area, _) in itertools.pairwise(regions):
        growth = (next_area - area) / max(area, 1)
        if area >= _LEAST_PX and growth < least and not _is_surroundings(rect, width, height):
            least, best = growth, rect
    return best


def _is_surroundings(rect: tuple[int, int, int, int], width: int, height: int) -> bool:
    x, y, across, down = rect
    if across * down > _LARGEST_SHARE * width * height:
        return True
    touched = (x <= 0) + (y <= 0) + (x + across >= width) + (y + down >= height)
    return touched >= 2
