"""Where a response peaks, and how clearly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, slots=True)
class Peak:
    """The highest point of a cyclic response.

    Attributes:
        across: shift to the right in cells, with a fraction.
        down: shift downwards in cells, with a fraction.
        sidelobe_ratio: the peak's height over the rest's mean, in the rest's standard deviations.
    """

    across: float
    down: float
    sidelobe_ratio: float


def find_peak(response: npt.NDArray[np.float32], lobe_columns: int, lobe_rows: int) -> Peak:
    """Return the peak of a (rows, columns) response whose shift 0 is at [0, 0].

    Args:
        response: cyclic in both directions.
        lobe_columns: half the width of the peak's own lobe, in cells.
        lobe_rows: half the height of the peak's own lobe, in cells.
    """
    rows, columns = response.shape
    row, column = divmod(int(response.argmax()), columns)
    down = row + vertex(
        response[row - 1, column], response[row, column], response[(row + 1) % rows, column]
    )
    across = column + vertex(
        response[row, column - 1], response[row, column], response[row, (column + 1) % columns]
    )
    return Peak(
        across - columns if across > columns / 2 else across,
        down - rows if down > rows / 2 else down,
        _sidelobe_ratio(response, row, column, lobe_columns, lobe_rows),
    )


def vertex(before: float, at: float, after: float) -> float:
    """Return where the parabola through three equidistant values peaks, -0.5 to 0.5."""
    bend = float(before) - 2 * float(at) + float(after)
    if bend >= 0:
        return 0.0
    return min(0.5, max(-0.5, 0.5 * (float(before) - float(after)) / bend))


def _sidelobe_ratio(
    response: npt.NDArray[np.float32], row: int, column: int, lobe_columns: int, lobe_rows: int
) -> float:
    """Peak to sidelobe ratio of Bolme et al., "Visual Object Tracking using Adaptive ..." 2010."""
    rows, columns = response.shape
    centred = np.roll(response, (rows // 2 - row, columns // 2 - column), axis=(0, 1))
    aside = np.ones(response.shape, np.bool_)
    aside[
        max(0, rows // 2 - lobe_rows) : rows // 2 + lobe_rows + 1,
        max(0, columns // 2 - lobe_columns) : columns // 2 + lobe_columns + 1,
    ] = False
    rest = centred[aside]
    return float((response[row, column] - rest.mean()) / (rest.std() + 1e-9))
