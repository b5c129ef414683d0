"""Finds the extent of the thing at a point that somebody pointed at."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.box import Box
from follower_vision.frame import Image

_REACHES = (0.03, 0.045, 0.07, 0.1, 0.15, 0.22)
"""Half the side of the part looked at, as shares of the image's longer side."""
_LARGEST_PX = 640
"""Larger images are made smaller: a click is not to hold up vision."""
_INNER = 0.72
"""The ring of surroundings begins at this share of the reach."""
_BINS = 24
_RARE = 0.25
_LEAST_PX = 12
_LEAST_SIDE_PX = 3
_NEAR_PX = 4.0

_Rect = tuple[int, int, int, int]


def box_around(image: Image, x: float, y: float) -> Box | None:
    """Return the box of what stands out from its surroundings at a point, None if nothing does.

    In ever larger squares about the point, the pixels whose colour is rare in the ring at the
    square's border are taken for the thing, and what is connected under the point is its extent.
    The largest square counts in which that does not reach the ring: in smaller ones it may be a
    part, such as a shirt. Within a large thing the ring has its own colours, and on open ground
    nothing is rare.

    Args:
        image: (H, W, 3) uint8 BGR.
        x: of the point, in pixels.
        y: likewise.
    """
    zoom = min(1.0, _LARGEST_PX / max(image.shape[:2]))
    small = cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA)
    lab = cv2.cvtColor(small, cv2.COLOR_BGR2Lab)
    place = int(x * zoom), int(y * zoom)
    sides = (max(round(reach * max(small.shape[:2])), 8) for reach in _REACHES)
    found = [rect for side in sides if (rect := _within(lab, *place, side)) is not None]
    return Box.from_xywh(*(length / zoom for length in found[-1])) if found else None


def _within(lab: npt.NDArray[Any], x: int, y: int, side: int) -> _Rect | None:
    height, width = lab.shape[:2]
    left, right = max(x - side, 0), min(x + side + 1, width)
    top, bottom = max(y - side, 0), min(y + side + 1, height)
    part = lab[top:bottom, left:right]
    if min(part.shape[:2]) < _LEAST_SIDE_PX:
        return None
    rows = np.abs(np.arange(top, bottom) - y)[:, None]
    columns = np.abs(np.arange(left, right) - x)[None, :]
    ring = np.maximum(rows, columns) > _INNER * side
    rect = _under(_rare(part, ring), ring, x - left, y - top)
    return None if rect is None else (rect[0] + left, rect[1] + top, rect[2], rect[3])


def _rare(part: npt.NDArray[Any], ring: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Return 1 where a pixel's colour is rare in the ring, else 0."""
    bins = (part.astype(np.int32) * _BINS) >> 8
    # Light and shade matter less than colour.
    index = (bins[..., 0] // 2 * _BINS + bins[..., 1]) * _BINS + bins[..., 2]
    counts = np.bincount(index[ring], minlength=_BINS**3 // 2).astype(np.float32)
    cube = counts.reshape(_BINS // 2, _BINS, _BINS)
    for axis in range(3):
        cube = cube + np.roll(cube, 1, axis) + np.roll(cube, -1, axis)
    density = cube.ravel()[index]
    usual = float(np.median(density[ring]))
    mask = np.asarray(density < _RARE * usual, np.uint8)
    kernel = np.ones((3, 3), np.uint8)
    closed = cv2.morphologyEx(cv2.medianBlur(mask, 3), cv2.MORPH_CLOSE, kernel)
    return np.asarray(closed, np.uint8)


def _under(mask: npt.NDArray[np.uint8], ring: npt.NDArray[Any], x: int, y: int) -> _Rect | None:
    """Return the box of the component at a point, or just beside it, unless it is in the ring."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    rows, columns = np.nonzero(labels)
    if not len(rows):
        return None
    distances = np.hypot(rows - y, columns - x)
    nearest = int(np.argmin(distances))
    if distances[nearest] > _NEAR_PX:
        return None
    label = labels[rows[nearest], columns[nearest]]
    left, top, across, down, area = (int(value) for value in stats[label])
    too_small = area < _LEAST_PX or min(across, down) < _LEAST_SIDE_PX
    if too_small or np.any(ring[labels == label]):
        return None
    return left, top, across, down
