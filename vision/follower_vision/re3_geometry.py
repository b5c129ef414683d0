"""What our Re3 network's crops cover, and how its answer becomes a box.

A target's scale is the side of the square of equal area. Both crops are squares about the last
box's middle, at the zoom that makes the scale `TARGET_PX` pixels.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from follower_vision.box import Box

TARGET_PX = 40
TEMPLATE_PX = 64
SEARCH_PX = 128
CELL_PX = 8
PLACES = SEARCH_PX // CELL_PX + 1

_MOST_GROWTH = 0.5


def template_region(box: Box) -> Box:
    """Return what the template crop about a box covers, in the image's pixels."""
    side = box.scale * TEMPLATE_PX / TARGET_PX
    return Box(box.cx, box.cy, side, side)


def search_region(box: Box) -> Box:
    """Return what the search crop about a box covers, in the image's pixels."""
    side = box.scale * SEARCH_PX / TARGET_PX
    return Box(box.cx, box.cy, side, side)


def relative_size(box: Box) -> tuple[float, float]:
    """Return a box's width and height in units of its scale."""
    return box.width / box.scale, box.height / box.scale


def relative_box(box: Box, last: Box) -> tuple[float, float, float, float]:
    """Return a box as the network is taught to say it, seen from the last one.

    That is the centre's shift in the last box's scales, and the logarithms of the growth of width
    and height.
    """
    scale = last.scale
    return (
        (box.cx - last.cx) / scale,
        (box.cy - last.cy) / scale,
        math.log(box.width / last.width),
        math.log(box.height / last.height),
    )


def absolute_box(answer: npt.NDArray[np.float32], last: Box) -> Box:
    """Return the box in the image that an answer (4,) means; the inverse of `relative_box`."""
    x, y, wider, taller = (float(value) for value in answer)
    wider = min(max(wider, -_MOST_GROWTH), _MOST_GROWTH)
    taller = min(max(taller, -_MOST_GROWTH), _MOST_GROWTH)
    return Box(
        last.cx + x * last.scale,
        last.cy + y * last.scale,
        last.width * math.exp(wider),
        last.height * math.exp(taller),
    )
