"""Moves a box's edges out to where the surroundings begin."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.box import Box
from follower_vision.frame import Image

_REFERENCE_LINES = 3
_LEAST_CONTRAST = 14.0
_FOREGROUND_SHARE = 0.4


def grown_to_contrast(image: Image, box: Box, max_growth_ratio: float) -> Box:
    """Return the box with each edge moved out over lines that differ from what lies beyond.

    A car's coloured body is surrounded by its dark wheels and windows; the road begins behind
    them. For each edge, the lines just beyond the largest growth stand for the surroundings, and
    the edge moves over those lines of which at least 40 % differ from them in Lab.

    Args:
        image: (H, W, 3) uint8 BGR.
        box: whole pixels are taken.
        max_growth_ratio: the furthest that an edge moves, as a share of the box's side.
    """
    x, y, w, h = (round(value) for value in box.xywh)
    across, down = round(w * max_growth_ratio), round(h * max_growth_ratio)
    margin = max(across, down) + _REFERENCE_LINES
    lab = _lab_around(image, (x, y, w, h), margin)
    if lab is None:
        return box
    columns = slice(margin, margin + w)
    rows = slice(margin, margin + h)
    top = _growth(lab[:margin, columns][::-1], down)
    bottom = _growth(lab[margin + h :, columns], down)
    left = _growth(lab[rows, :margin].swapaxes(0, 1)[::-1], across)
    right = _growth(lab[rows, margin + w :].swapaxes(0, 1), across)
    return Box.from_xywh(x - left, y - top, w + left + right, h + top + bottom)


def _lab_around(
    image: Image, whole: tuple[int, int, int, int], margin: int
) -> npt.NDArray[np.float32] | None:
    """The box and a margin in Lab; None where the margin leaves the image."""
    x, y, w, h = whole
    height, width = image.shape[:2]
    if x < margin or y < margin or x + w + margin > width or y + h + margin > height:
        return None
    patch = image[y - margin : y + h + margin, x - margin : x + w + margin]
    return cv2.cvtColor(patch, cv2.COLOR_BGR2Lab).astype(np.float32)


def _growth(lines: npt.NDArray[Any], most: int) -> int:
    """How many of the lines (nearest the box first) belong to the target, at most `most`."""
    if most < 1:
        return 0
    beyond = lines[most : most + _REFERENCE_LINES].reshape(-1, 3)
    middle = np.median(beyond, axis=0)
    spread = np.median(np.abs(beyond - middle).sum(axis=1))
    distance = np.abs(lines[:most] - middle).sum(axis=2)
    share = (distance > max(_LEAST_CONTRAST, 3 * spread)).mean(axis=1)
    differs = share >= _FOREGROUND_SHARE
    return int(most if differs.all() else np.argmin(differs))
