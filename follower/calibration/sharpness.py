"""How blurred a board is in an image."""

from __future__ import annotations

import math
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from follower.calibration.board import Board, Points, SeenBoard
from follower_vision.frame import Image

_Grey: TypeAlias = npt.NDArray[np.float32]

_STEP_PX, _MOST_SAMPLES = 0.5, 201
_REACH = 0.45
"""Of a square's side, to either side of an edge."""


def blur_px(board: Board, seen: SeenBoard, image: Image) -> float:
    """Return over how many pixels the edges between squares go from black to white.

    Across the middle of each edge: the contrast over the steepest slope. The median of the edges;
    about 1.5 for a sharp image, infinity if no edge has both ends in view.
    """
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.float32)
    places = {int(one): seen.image_px[row] for row, one in enumerate(seen.ids)}
    widths = [
        _width_px(grey, places[one], places[other])
        for one in places
        for other in _neighbours(board, one)
        if other in places
    ]
    return float(np.median(widths)) if widths else math.inf


def _neighbours(board: Board, corner: int) -> list[int]:
    columns = board.across - 1
    right = [corner + 1] if (corner + 1) % columns else []
    return [*right, corner + columns]


def _width_px(grey: _Grey, one: Points, other: Points) -> float:
    """Return the width of the edge between two corners."""
    along = other - one
    across = np.array([-along[1], along[0]])
    reach_px = float(np.hypot(*across)) * _REACH
    samples = min(_MOST_SAMPLES, 2 * math.ceil(reach_px / _STEP_PX) + 3)
    steps = np.linspace(-_REACH, _REACH, samples)[:, None]
    places = ((one + other) / 2 + steps * across - 0.5).astype(np.float32)
    x, y = places[:, :1], places[:, 1:]
    values = cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    profile = np.asarray(values, np.float64).reshape(-1)
    steepest = float(np.abs(np.diff(profile)).max()) * (samples - 1) / (2 * reach_px)
    return float(np.ptp(profile)) / steepest if steepest > 0 else math.inf
