"""YOLO v2 (Redmon and Farhadi 2017): the region layer, with anchor boxes. The paper's detector."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from follower_vision.detection.candidates import (
    Candidates,
    best_class,
    from_centres,
    grid_points,
    sigmoid,
    softmax,
)
from follower_vision.detection.layout import NetworkLayout
from follower_vision.detection.pixels import InputFormat, Placement
from follower_vision.network import Tensor

STRIDE = 32
COCO_ANCHORS = (
    (0.57273, 0.677385),
    (1.87446, 2.06253),
    (3.33843, 5.47434),
    (7.88282, 3.52778),
    (9.77052, 9.16828),
)
"""Width and height in cells, from darknet's yolov2.cfg."""
VOC_ANCHORS = (
    (1.3221, 1.73145),
    (3.19275, 4.00944),
    (5.05587, 8.09892),
    (9.47112, 4.84053),
    (11.2364, 10.0071),
)
"""Width and height in cells, from darknet's yolov2-voc.cfg."""


class YoloV2Decoder:
    """Reads (1, anchors * (5 + classes), rows, columns): box, objectness, classes an anchor."""

    input_format = InputFormat(
        Placement.CENTRE, fill=127.0, red_first=True, deviation=(255.0, 255.0, 255.0)
    )

    def __init__(
        self, layout: NetworkLayout, anchors: Sequence[tuple[float, float]] | None = None
    ) -> None:
        """Prepare for a network.

        Args:
            layout: the network's.
            anchors: widths and heights in cells; None takes those that the file names, or
                darknet's for VOC's twenty classes or, for any other number, those for COCO.
        """
        anchors = anchors or layout.anchors
        count = len(anchors) if anchors else len(COCO_ANCHORS)
        self.classes = layout.only_output[1] // count - 5
        known = VOC_ANCHORS if self.classes == 20 else COCO_ANCHORS
        self._anchors = np.array(anchors or known, np.float32)
        self._cells = grid_points(*layout.grid(STRIDE))

    @staticmethod
    def fits(layout: NetworkLayout) -> bool:
        """Tell whether the outputs look like this family's, with the file's anchors or five."""
        shape = layout.only_output
        if len(shape) != 4 or shape[2:] != layout.grid(STRIDE):
            return False
        count = len(layout.anchors or COCO_ANCHORS)
        return shape[1] % count == 0 and shape[1] // count > 5

    def decode(self, outputs: Sequence[Tensor], min_score: float) -> Candidates:
        """Return the boxes with at least a score, in input pixels."""
        values = outputs[0][0].reshape(len(self._anchors), self.classes + 5, -1)
        objectness = sigmoid(values[:, 4])
        anchor, cell = np.nonzero(objectness >= min_score)
        rows = values[anchor, :, cell]
        best, classes = best_class(softmax(rows[:, 5:]))
        centres = (self._cells[cell] + sigmoid(rows[:, :2])) * STRIDE
        sizes = self._anchors[anchor] * np.exp(rows[:, 2:4]) * STRIDE
        scores = objectness[anchor, cell] * best
        return Candidates(from_centres(centres, sizes), scores, classes).above(min_score)
