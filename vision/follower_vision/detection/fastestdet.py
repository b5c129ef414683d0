"""FastestDet (dog-qiuqiu): one grid, one box a cell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from follower_vision.detection.candidates import (
    Candidates,
    best_class,
    from_centres,
    grid_points,
    sigmoid,
)
from follower_vision.detection.layout import NetworkLayout
from follower_vision.detection.pixels import InputFormat, Placement
from follower_vision.network import Tensor

STRIDE = 16


class FastestDetDecoder:
    """Reads (1, 5 + classes, rows, columns): objectness, box, and a score for each class."""

    input_format = InputFormat(Placement.STRETCH, deviation=(255.0, 255.0, 255.0))

    def __init__(self, layout: NetworkLayout) -> None:
        self.classes = layout.only_output[1] - 5
        rows, columns = layout.grid(STRIDE)
        self._cells = grid_points(rows, columns)
        self._size = np.array([layout.width, layout.height], np.float32)
        self._cell_size = self._size / np.array([columns, rows], np.float32)

    @staticmethod
    def fits(layout: NetworkLayout) -> bool:
        """Tell whether a network's outputs look like this family's."""
        shape = layout.only_output
        return len(shape) == 4 and shape[2:] == layout.grid(STRIDE) and shape[1] > 5

    def decode(self, outputs: Sequence[Tensor], min_score: float) -> Candidates:
        """Return the boxes with at least a score, in input pixels."""
        flat = outputs[0][0].reshape(self.classes + 5, -1)
        # Score = objectness^0.6 * class^0.4, so that objectness alone rules most cells out.
        likely = np.flatnonzero(flat[0] >= min_score ** (1 / 0.6))
        rows = flat[:, likely].T
        best, classes = best_class(rows[:, 5:])
        scores = rows[:, 0] ** 0.6 * best**0.4
        centres = (self._cells[likely] + np.tanh(rows[:, 1:3])) * self._cell_size
        corners = from_centres(centres, sigmoid(rows[:, 3:5]) * self._size)
        return Candidates(corners, scores, classes).above(min_score)
