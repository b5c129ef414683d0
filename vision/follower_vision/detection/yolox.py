"""YOLOX (Ge et al. 2021): one box a cell, without anchors, on three grids."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from follower_vision.detection.candidates import Candidates, best_class, from_centres, grid_points
from follower_vision.detection.layout import NetworkLayout
from follower_vision.detection.pixels import InputFormat, Placement
from follower_vision.network import Tensor

STRIDES = (8, 16, 32)


class YoloxDecoder:
    """Reads (1, cells, 5 + classes): centre, size, objectness and a score for each class."""

    input_format = InputFormat(Placement.CORNER)

    def __init__(self, layout: NetworkLayout) -> None:
        self.classes = layout.only_output[2] - 5
        grids = [grid_points(*layout.grid(stride)) for stride in STRIDES]
        self._cells = np.concatenate(grids)
        strides = [
            np.full((len(grid), 1), stride) for grid, stride in zip(grids, STRIDES, strict=True)
        ]
        self._strides = np.concatenate(strides).astype(np.float32)

    @staticmethod
    def fits(layout: NetworkLayout) -> bool:
        """Tell whether a network's outputs look like this family's."""
        shape = layout.only_output
        return len(shape) == 3 and shape[1] == layout.cells(STRIDES) and shape[2] > 5

    def decode(self, outputs: Sequence[Tensor], min_score: float) -> Candidates:
        """Return the boxes with at least a score, in input pixels."""
        # A score is objectness times class score, and so never above the objectness.
        likely = np.flatnonzero(outputs[0][0, :, 4] >= min_score)
        rows, strides = outputs[0][0, likely], self._strides[likely]
        scores, classes = best_class(rows[:, 5:])
        centres = (rows[:, :2] + self._cells[likely]) * strides
        corners = from_centres(centres, np.exp(rows[:, 2:4]) * strides)
        return Candidates(corners, scores * rows[:, 4], classes).above(min_score)
