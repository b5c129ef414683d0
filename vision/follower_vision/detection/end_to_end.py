"""The families of detection networks that choose among their boxes themselves."""

from collections.abc import Sequence

import numpy as np

from follower_vision.detection.detection import (
    Candidates,
    InputFormat,
    NetworkLayout,
    Placement,
    best_class,
    from_centres,
    sigmoid,
)
from follower_vision.onnx_network import Tensor

MOST_ROWS = 1000
"""A network that chooses gives fewer boxes than this (usually 300); one that does not, more."""
_SHARES_HEAD = "RTDETRDecoder"
_TO_UNIT = (255.0, 255.0, 255.0)


class YoloEndToEndDecoder:
    """Reads (1, rows, 6): left, top, right, bottom in input pixels, score, class.

    Ultralytics writes this for YOLOv10 and YOLO26, and for others exported with `nms=True`.
    """

    layout = "(1, rows, 6)"
    input_format = InputFormat(Placement.CENTRE, red_first=True, deviation=_TO_UNIT)

    classes = 0

    def __init__(self, layout: NetworkLayout) -> None:
        """Take any layout that fits."""

    @staticmethod
    def fits(layout: NetworkLayout) -> bool:
        """Return whether a network's outputs have this family's shapes."""
        return _are_chosen_rows(layout) and layout.head != _SHARES_HEAD

    def decode(self, outputs: Sequence[Tensor], min_score: float) -> Candidates:
        """Return the boxes with at least a score, in input pixels."""
        return _chosen_rows(outputs, min_score)


class UltralyticsRtDetrDecoder:
    """Reads (1, rows, 6): centre and size as shares of the input, score, class.

    Only the last layer's name in the file tells this from `YoloEndToEndDecoder`'s.
    """

    layout = f"(1, rows, 6) of a head {_SHARES_HEAD}"
    input_format = InputFormat(Placement.STRETCH, red_first=True, deviation=_TO_UNIT)
    classes = 0

    def __init__(self, layout: NetworkLayout) -> None:
        self._size = np.array([layout.width, layout.height], np.float32)

    @staticmethod
    def fits(layout: NetworkLayout) -> bool:
        """Return whether a network's outputs have this family's shapes and its head the name."""
        return _are_chosen_rows(layout) and layout.head == _SHARES_HEAD

    def decode(self, outputs: Sequence[Tensor], min_score: float) -> Candidates:
        """Return the boxes with at least a score, in input pixels."""
        found = _chosen_rows(outputs, min_score)
        boxes = found.corners * np.tile(self._size, 2)
        return Candidates(from_centres(boxes[:, :2], boxes[:, 2:]), found.scores, found.classes)


def _are_chosen_rows(layout: NetworkLayout) -> bool:
    shape = layout.only_output
    return len(shape) == 3 and shape[2] == 6 and shape[1] <= MOST_ROWS


def _chosen_rows(outputs: Sequence[Tensor], min_score: float) -> Candidates:
    """Return rows of a box, a score and a class as they are."""
    rows = outputs[0][0]
    rows = rows[(rows[:, 4] >= min_score) & np.isfinite(rows[:, 5])]
    return Candidates(rows[:, :4], rows[:, 4], rows[:, 5].astype(np.intp))


class RtDetrDecoder:
    """Reads logits (1, rows, classes) and boxes (1, rows, 4): centre, size as shares of the input.

    RT-DETR and D-FINE as Transformers and Optimum export them; told by the outputs' names, since
    others give boxes of another kind in the same shapes.
    """

    layout = "logits (1, rows, classes) with boxes or pred_boxes (1, rows, 4)"
    input_format = InputFormat(Placement.STRETCH, red_first=True, deviation=_TO_UNIT)

    def __init__(self, layout: NetworkLayout) -> None:
        self._logits, self._boxes = _place(layout, "logits"), _place(layout, "boxes")
        self.classes = layout.outputs[self._logits][1][2]
        self._size = np.array([layout.width, layout.height], np.float32)

    @staticmethod
    def fits(layout: NetworkLayout) -> bool:
        """Return whether a network's outputs have this family's names and shapes."""
        shapes = {name.removeprefix("pred_"): shape for name, shape in layout.outputs}
        if shapes.keys() != {"logits", "boxes"} or {*map(len, shapes.values())} != {3}:
            return False
        return shapes["logits"][:2] == shapes["boxes"][:2] and shapes["boxes"][2] == 4

    def decode(self, outputs: Sequence[Tensor], min_score: float) -> Candidates:
        """Return the boxes with at least a score, in input pixels."""
        best, classes = best_class(outputs[self._logits][0])
        scores = sigmoid(best)
        boxes = outputs[self._boxes][0] * np.tile(self._size, 2)
        corners = from_centres(boxes[:, :2], boxes[:, 2:])
        return Candidates(corners, scores, classes).above(min_score)


class DetrDeployDecoder:
    """Reads labels (1, rows), boxes (1, rows, 4) in input pixels and scores (1, rows).

    RT-DETR, D-FINE and DEIM as their own `export_onnx.py` writes them: a second input takes the
    size, width before height, in which the boxes are given.
    """

    layout = "labels (1, rows) with boxes (1, rows, 4) and scores (1, rows)"
    input_format = RtDetrDecoder.input_format
    classes = 0

    def __init__(self, layout: NetworkLayout) -> None:
        self._order = [_place(layout, name) for name in ("labels", "boxes", "scores")]

    @staticmethod
    def fits(layout: NetworkLayout) -> bool:
        """Return whether a network's outputs have this family's names and shapes."""
        shapes = dict(layout.outputs)
        if shapes.keys() != {"labels", "boxes", "scores"}:
            return False
        rows = shapes["scores"]
        return len(rows) == 2 and shapes["labels"] == rows and shapes["boxes"] == (*rows, 4)

    def decode(self, outputs: Sequence[Tensor], min_score: float) -> Candidates:
        """Return the boxes with at least a score, in input pixels."""
        labels, boxes, scores = (outputs[place][0] for place in self._order)
        return Candidates(boxes, scores, labels.astype(np.intp)).above(min_score)


def _place(layout: NetworkLayout, name: str) -> int:
    """Return the place of an output, whose name may begin with "pred_"."""
    return [one.removeprefix("pred_") for one, _ in layout.outputs].index(name)
