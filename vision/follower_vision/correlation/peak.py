"""Where a response peaks, and how clearly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Response = npt.NDArray[np.float32]
"""Evidence by shift, shape (rows, columns), cyclic in both directions; shift 0 is at [0, 0]."""


@dataclass(frozen=True, slots=True)
class Peak:
    """The highest point of a response.

    Attributes:
        across: shift to the right in cells, with a fraction.
        down: shift downwards in cells, with a fraction.
    """

    across: float
    down: float


def find_peak(response: Response) -> Peak:
    """Return a response's peak."""
    rows, columns = response.shape
    row, column = divmod(int(response.argmax()), columns)
    height = response[row, column]
    down = row + vertex(response[row - 1, column], height, response[(row + 1) % rows, column])
    right = response[row, (column + 1) % columns]
    across = column + vertex(response[row, column - 1], height, right)
    return Peak(
        across - columns if across > columns / 2 else across,
        down - rows if down > rows / 2 else down,
    )


def vertex(before: float, at: float, after: float) -> float:
    """Return where the parabola through three equidistant values peaks, -0.5 to 0.5."""
    bend = float(before) - 2 * float(at) + float(after)
    if bend >= 0:
        return 0.0
    return min(0.5, max(-0.5, 0.5 * (float(before) - float(after)) / bend))


def sidelobe_ratio(response: Response, lobe: int) -> float:
    """Return the peak's height over the rest's mean, in the rest's standard deviations.

    After Bolme, Beveridge, Draper and Lui, "Visual Object Tracking using Adaptive Correlation
    Filters" (CVPR 2010).

    Args:
        response: cyclic; 0 is returned for a flat one.
        lobe: half the side of the square about the peak that is left out, in cells.
    """
    rows, columns = response.shape
    row, column = divmod(int(response.argmax()), columns)
    centred = np.roll(response, (rows // 2 - row, columns // 2 - column), axis=(0, 1))
    aside = np.ones(response.shape, np.bool_)
    lobe_rows = slice(max(0, rows // 2 - lobe), rows // 2 + lobe + 1)
    lobe_columns = slice(max(0, columns // 2 - lobe), columns // 2 + lobe + 1)
    aside[lobe_rows, lobe_columns] = False
    rest = centred[aside]
    if rest.size == 0:
        return 0.0
    return float((response[row, column] - rest.mean()) / (rest.std() + 1e-9))
