"""Random textures that look grown: sums of smooth noise at several scales."""

import math
from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

Grey = npt.NDArray[np.uint8]


def smooth_noise(
    rng: np.random.Generator, height: int, width: int, cell_px: float, contrast: float
) -> Grey:
    """Return grey noise about 128 whose blobs are `cell_px` wide.

    Args:
        rng: source of randomness.
        height: rows.
        width: columns.
        cell_px: distance of the random values that are interpolated; at 1 each pixel is one.
        contrast: standard deviation of the random values, in grey levels.
    """
    rows, columns = math.ceil(height / cell_px) + 1, math.ceil(width / cell_px) + 1
    values = rng.standard_normal((rows, columns), np.float32) * contrast + 128
    coarse = np.clip(values, 0, 255).astype(np.uint8)
    if cell_px <= 1:
        return np.asarray(coarse[:height, :width], np.uint8)
    size = (math.ceil(columns * cell_px), math.ceil(rows * cell_px))
    return np.asarray(
        cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)[:height, :width], np.uint8
    )


def layered_noise(
    rng: np.random.Generator, height: int, width: int, layers: Sequence[tuple[float, float]]
) -> Grey:
    """Return the sum, about 128, of smooth noises given as (cell in pixels, contrast)."""
    total: Grey = np.full((height, width), 128, np.uint8)
    for cell, contrast in layers:
        layer = smooth_noise(rng, height, width, cell, contrast)
        total = np.asarray(cv2.addWeighted(total, 1.0, layer, 1.0, -128.0), np.uint8)
    return total
