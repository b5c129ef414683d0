"""Reads a network's answers as the detector in flight does."""

from __future__ import annotations

import numpy as np

from follower_vision.detection.candidates import Candidates
from follower_vision.detection.layout import NetworkLayout
from follower_vision.detection.yolov2 import STRIDE, YoloV2Decoder
from follower_vision.network import Tensor
from follower_vision.nms import keep_best

_LEAST_SCORE = 0.01
_OVERLAP = 0.45
_MOST = 100


class AnswerReader:
    """Turns a region layer's input into boxes, overlapping ones removed, for measuring.

    Args:
        anchors: (A, 2) in cells.
        classes: how many.
        side_px: of the square input.
    """

    def __init__(self, anchors: np.ndarray, classes: int, side_px: int) -> None:
        cells, depth = side_px // STRIDE, len(anchors) * (5 + classes)
        pairs = tuple((float(width), float(height)) for width, height in anchors)
        shape = (1, depth, cells, cells)
        self._decoder = YoloV2Decoder(NetworkLayout(side_px, side_px, (("region", shape),), pairs))

    def read(self, answer: Tensor, least_score: float = _LEAST_SCORE) -> Candidates:
        """Return the boxes in pixels of the input, of an answer (A * (5 + classes), H, W)."""
        found = self._decoder.decode([answer[None]], least_score).sound()
        kept: list[int] = []
        for number in np.unique(found.classes).tolist():
            mine = np.flatnonzero(found.classes == number)
            best = keep_best(found.corners[mine], found.scores[mine], _OVERLAP, _MOST)
            kept += mine[best].tolist()
        return Candidates(found.corners[kept], found.scores[kept], found.classes[kept])
