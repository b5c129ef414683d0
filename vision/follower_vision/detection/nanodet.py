"""NanoDet and NanoDet-Plus (RangiLyu): distances to the sides as distributions over bins."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from follower_vision.detection.candidates import (
    Candidates,
    best_class,
    grid_points,
    sigmoid,
    softmax,
)
from follower_vision.detection.layout import NetworkLayout
from follower_vision.detection.pixels import InputFormat, Placement
from follower_vision.network import Tensor

STRIDES = (8, 16, 32)
PLUS_STRIDES = (8, 16, 32, 64)
PLUS_BINS = 8


class NanoDetDecoder:
    """Reads class scores and bins of distances, (1, cells, classes) and (1, cells, 4 * bins).

    NanoDet has both for each of three grids; NanoDet-Plus has four grids, as eight outputs or
    joined into one of (1, cells, classes + 32).
    """

    input_format = InputFormat(
        Placement.CENTRE,
        fill=0.0,
        mean=(103.53, 116.28, 123.675),
        deviation=(57.375, 57.12, 58.395),
    )

    def __init__(self, layout: NetworkLayout) -> None:
        strides = _strides(layout)
        self._joined = len(layout.outputs) == 1
        self._order = [] if self._joined else _output_order(layout, strides)
        self._points, self._strides = _centres(layout, strides)
        last = layout.outputs[0 if self._joined else self._order[0]][1][2]
        self.classes = last - 4 * PLUS_BINS if self._joined else last

    @staticmethod
    def fits(layout: NetworkLayout) -> bool:
        """Tell whether a network's outputs look like this family's."""
        if len(layout.outputs) == 1:
            shape = layout.only_output
            joined = len(shape) == 3 and shape[1] == layout.cells(PLUS_STRIDES)
            return joined and shape[2] > 4 * PLUS_BINS
        return len(layout.outputs) in (6, 8) and bool(_output_order(layout, _strides(layout)))

    def decode(self, outputs: Sequence[Tensor], min_score: float) -> Candidates:
        """Return the boxes with at least a score, in input pixels."""
        classes, bins = self._split(outputs)
        if classes.min() < 0 or classes.max() > 1:
            classes = sigmoid(classes)
        likely = np.flatnonzero(classes.max(axis=1) >= min_score)
        scores, class_ids = best_class(classes[likely])
        return Candidates(self._corners(bins[likely], likely), scores, class_ids)

    def _split(self, outputs: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
        """Return the class scores and the bins of all grids, (cells, ...) each."""
        if self._joined:
            return outputs[0][0, :, : self.classes], outputs[0][0, :, self.classes :]
        ordered = [outputs[index][0] for index in self._order]
        half = len(ordered) // 2
        return np.concatenate(ordered[:half]), np.concatenate(ordered[half:])

    def _corners(self, bins: Tensor, cells: np.ndarray) -> Tensor:
        shares = softmax(bins.reshape(len(bins), 4, bins.shape[1] // 4))
        steps = np.arange(shares.shape[2], dtype=np.float32)
        distances = (shares @ steps) * self._strides[cells]
        points = self._points[cells]
        return np.hstack([points - distances[:, :2], points + distances[:, 2:]])


def _strides(layout: NetworkLayout) -> tuple[int, ...]:
    return STRIDES if len(layout.outputs) == 6 else PLUS_STRIDES


def _centres(layout: NetworkLayout, strides: Sequence[int]) -> tuple[Tensor, Tensor]:
    """Return each cell's point in input pixels, (cells, 2), and its stride, (cells, 1)."""
    grids = [grid_points(*layout.grid(stride)) for stride in strides]
    # NanoDet measures from a cell's middle pixel, NanoDet-Plus from its first.
    offset = 0.5 if strides == STRIDES else 0.0
    points = [grid * s + offset * (s - 1) for grid, s in zip(grids, strides, strict=True)]
    sizes = [np.full((len(grid), 1), s) for grid, s in zip(grids, strides, strict=True)]
    return np.concatenate(points).astype(np.float32), np.concatenate(sizes).astype(np.float32)


def _output_order(layout: NetworkLayout, strides: Sequence[int]) -> list[int]:
    """Return the outputs' places: class scores from the finest grid on, then bins; or []."""
    pairs = []
    for stride in strides:
        cells = layout.cells([stride])
        pair = [i for i, (_, shape) in enumerate(layout.outputs) if _is_grid(shape, cells)]
        if len(pair) != 2:
            return []
        pairs.append(_classes_first(layout, pair))
    ordered = [first for first, _ in pairs] + [second for _, second in pairs]
    return ordered if layout.outputs[ordered[-1]][1][2] % 4 == 0 else []


def _is_grid(shape: tuple[int, ...], cells: int) -> bool:
    return len(shape) == 3 and shape[1] == cells


def _classes_first(layout: NetworkLayout, pair: list[int]) -> tuple[int, int]:
    """Put the class scores first: exporters do, unless the names say otherwise."""
    first, second = pair
    named_as_bins = layout.outputs[first][0].startswith(("dis", "reg"))
    return (second, first) if named_as_bins else (first, second)
