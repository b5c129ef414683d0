"""YOLOv8 and YOLO11: boxes in input pixels and class scores, without objectness."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from follower_vision.detection.candidates import Candidates, best_class, from_centres
from follower_vision.detection.layout import NetworkLayout
from follower_vision.detection.pixels import InputFormat, Placement
from follower_vision.network import Tensor

STRIDES = (8, 16, 32)


class YoloV8Decoder:
    """Reads (1, 4 + classes, cells): centre and size in input pixels, a score for each class."""

    input_format = InputFormat(Placement.CENTRE, red_first=True, deviation=(255.0, 255.0, 255.0))

    def __init__(self, layout: NetworkLayout) -> None:
        self.classes = layout.only_output[1] - 4

    @staticmethod
    def fits(layout: NetworkLayout) -> bool:
        """Tell whether a network's outputs look like this family's."""
        shape = layout.only_output
        return len(shape) == 3 and shape[2] == layout.cells(STRIDES) and shape[1] > 4

    def decode(self, outputs: Sequence[Tensor], min_score: float) -> Candidates:
        """Return the boxes with at least a score, in input pixels."""
        # Along the long axis numpy is quick; the few good columns alone are turned into rows.
        likely = np.flatnonzero(outputs[0][0, 4:].max(axis=0) >= min_score)
        rows = outputs[0][0][:, likely].T
        scores, classes = best_class(rows[:, 4:])
        return Candidates(from_centres(rows[:, :2], rows[:, 2:4]), scores, classes)
