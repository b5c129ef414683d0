"""The families of detection networks, and which one a network is of."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from follower_vision.detection.detection import (
    Candidates,
    InputFormat,
    NetworkLayout,
    Placement,
    best_class,
    from_centres,
    grid_points,
    sigmoid,
    softmax,
)
from follower_vision.detection.end_to_end import (
    DetrDeployDecoder,
    RtDetrDecoder,
    UltralyticsRtDetrDecoder,
    YoloEndToEndDecoder,
)
from follower_vision.onnx_network import Tensor

FASTESTDET_STRIDE = 16
STRIDES = (8, 16, 32)
"""Of the three grids of NanoDet, YOLOv8 and YOLOX, in pixels of the input."""
PLUS_STRIDES = (8, 16, 32, 64)
PLUS_BINS = 8
YOLOV2_STRIDE = 32
_ANCHORS = 3
"""Of each of YOLOv5's cells."""
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


def _cells_and_strides(layout: NetworkLayout, strides: Sequence[int]) -> tuple[Tensor, Tensor]:
    """Return column and row of each cell of all grids, (cells, 2), and its stride, (cells, 1)."""
    grids = [grid_points(*layout.grid(stride)) for stride in strides]
    sizes = np.repeat(np.array(strides, np.float32), [len(grid) for grid in grids])
    return np.concatenate(grids), sizes[:, None]


class FastestDetDecoder:
    """Reads (1, 5 + classes, rows, columns): objectness, box, and a score for each class."""

    layout = "(1, 5 + classes, rows, columns) of cells of 16 pixels"
    input_format = InputFormat(Placement.STRETCH, deviation=(255.0, 255.0, 255.0))

    def __init__(self, layout: NetworkLayout) -> None:
        self.classes = layout.only_output[1] - 5
        rows, columns = layout.grid(FASTESTDET_STRIDE)
        self._cells = grid_points(rows, columns)
        self._size = np.array([layout.width, layout.height], np.float32)
        self._cell_size = self._size / np.array([columns, rows], np.float32)

    @staticmethod
    def fits(layout: NetworkLayout) -> bool:
        """Return whether a network's outputs have this family's shapes."""
        shape = layout.only_output
        return len(shape) == 4 and shape[2:] == layout.grid(FASTESTDET_STRIDE) and shape[1] > 5

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


class NanoDetDecoder:
    """Reads class scores and bins of distances, (1, cells, classes) and (1, cells, 4 * bins).

    NanoDet has both for each of three grids; NanoDet-Plus has four grids, as eight outputs or
    joined into one of (1, cells, classes + 32).
    """

    layout = "(1, cells, classes) and (1, cells, 32) for each grid"
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
        """Return whether a network's outputs have this family's shapes."""
        if len(layout.outputs) == 1:
            shape = layout.only_output
            joined = len(shape) == 3 and shape[1] == layout.cells(PLUS_STRIDES)
            return joined and shape[2] > 4 * PLUS_BINS
        return len(layout.outputs) in (6, 8) and bool(_output_order(layout, _strides(layout)))

    def decode(self, outputs: Sequence[Tensor], min_score: float) -> Candidates:
        """Return the boxes with at least a score, in input pixels."""
        classes, bins = self._split(outputs)
        if ((classes < 0) | (classes > 1)).any():  # also beside one that is no number
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
    cells, sizes = _cells_and_strides(layout, strides)
    # NanoDet measures from a cell's middle pixel, NanoDet-Plus from its first.
    offset = 0.5 if strides == STRIDES else 0.0
    return (cells * sizes + offset * (sizes - 1)).astype(np.float32), sizes


def _output_order(layout: NetworkLayout, strides: Sequence[int]) -> list[int]:
    """Return the outputs' places: class scores from the finest grid on, then bins; or []."""
    pairs = []
    for stride in strides:
        cells = layout.cells([stride])
        shapes = [shape for _, shape in layout.outputs]
        pair = [i for i, s in enumerate(shapes) if len(s) == 3 and s[1] == cells]
        if len(pair) != 2:
            return []
        pairs.append(_classes_first(layout, pair))
    ordered = [first for first, _ in pairs] + [second for _, second in pairs]
    return ordered if layout.outputs[ordered[-1]][1][2] % 4 == 0 else []


def _classes_first(layout: NetworkLayout, pair: list[int]) -> tuple[int, int]:
    """Put the class scores first: exporters do, unless the names say otherwise."""
    first, second = pair
    named_as_bins = layout.outputs[first][0].startswith(("dis", "reg"))
    return (second, first) if named_as_bins else (first, second)


class YoloV2Decoder:
    """Reads (1, anchors * (5 + classes), rows, columns): box, objectness, classes an anchor."""

    layout = "(1, anchors * (5 + classes), rows, columns) of cells of 32 pixels"
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
        self._cells = grid_points(*layout.grid(YOLOV2_STRIDE))

    @staticmethod
    def fits(layout: NetworkLayout) -> bool:
        """Return whether the outputs have this family's shapes, with the file's anchors or five."""
        shape = layout.only_output
        if len(shape) != 4 or shape[2:] != layout.grid(YOLOV2_STRIDE):
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
        centres = (self._cells[cell] + sigmoid(rows[:, :2])) * YOLOV2_STRIDE
        sizes = self._anchors[anchor] * np.exp(rows[:, 2:4]) * YOLOV2_STRIDE
        scores = objectness[anchor, cell] * best
        return Candidates(from_centres(centres, sizes), scores, classes).above(min_score)


class YoloV8Decoder:
    """Reads (1, 4 + classes, cells): centre and size in input pixels, a score for each class."""

    layout = "(1, 4 + classes, cells)"
    input_format = InputFormat(Placement.CENTRE, red_first=True, deviation=(255.0, 255.0, 255.0))

    def __init__(self, layout: NetworkLayout) -> None:
        self.classes = layout.only_output[1] - 4

    @staticmethod
    def fits(layout: NetworkLayout) -> bool:
        """Return whether a network's outputs have this family's shapes."""
        shape = layout.only_output
        return len(shape) == 3 and shape[2] == layout.cells(STRIDES) and shape[1] > 4

    def decode(self, outputs: Sequence[Tensor], min_score: float) -> Candidates:
        """Return the boxes with at least a score, in input pixels."""
        # Along the long axis numpy is quick; the few good columns alone are turned into rows.
        likely = np.flatnonzero(outputs[0][0, 4:].max(axis=0) >= min_score)
        rows = outputs[0][0][:, likely].T
        scores, classes = best_class(rows[:, 4:])
        return Candidates(from_centres(rows[:, :2], rows[:, 2:4]), scores, classes)


class YoloV5Decoder:
    """Reads (1, 3 * cells, 5 + classes): centre, size in input pixels, objectness, a class's score.

    YOLOv5 and YOLOv7; the cells are those of three grids or, with a fourth of 64 pixels, of four.
    """

    layout = "(1, 3 * cells, 5 + classes)"
    input_format = YoloV8Decoder.input_format

    def __init__(self, layout: NetworkLayout) -> None:
        self.classes = layout.only_output[2] - 5

    @staticmethod
    def fits(layout: NetworkLayout) -> bool:
        """Return whether a network's outputs have this family's shapes."""
        shape = layout.only_output
        rows = [_ANCHORS * layout.cells(strides) for strides in (STRIDES, PLUS_STRIDES)]
        return len(shape) == 3 and shape[1] in rows and shape[2] > 5

    def decode(self, outputs: Sequence[Tensor], min_score: float) -> Candidates:
        """Return the boxes with at least a score, in input pixels."""
        # A score is objectness times class score, and so never above the objectness.
        rows = outputs[0][0, outputs[0][0, :, 4] >= min_score]
        best, classes = best_class(rows[:, 5:])
        corners = from_centres(rows[:, :2], rows[:, 2:4])
        return Candidates(corners, rows[:, 4] * best, classes).above(min_score)


class YoloxDecoder:
    """Reads (1, cells, 5 + classes): centre, size, objectness and a score for each class."""

    layout = "(1, cells, 5 + classes)"
    input_format = InputFormat(Placement.CORNER)

    def __init__(self, layout: NetworkLayout) -> None:
        self.classes = layout.only_output[2] - 5
        self._cells, self._strides = _cells_and_strides(layout, STRIDES)

    @staticmethod
    def fits(layout: NetworkLayout) -> bool:
        """Return whether a network's outputs have this family's shapes."""
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


class Decoder(Protocol):
    """Knows what a family's networks are shown, and what their answers mean."""

    @property
    def input_format(self) -> InputFormat:
        """What the networks are shown."""
        ...

    @property
    def classes(self) -> int:
        """How many classes the network distinguishes; 0 where its outputs do not say."""
        ...

    def decode(self, outputs: Sequence[Tensor], min_score: float) -> Candidates:
        """Return the boxes with at least a score, in input pixels."""
        ...


class DecoderClass(Protocol):
    """Makes a decoder for the networks that fit."""

    @property
    def layout(self) -> str:
        """The outputs' shapes in words, for messages."""
        ...

    def __call__(self, layout: NetworkLayout) -> Decoder:
        """Make the decoder for one network."""
        ...

    def fits(self, layout: NetworkLayout) -> bool:
        """Return whether a network's outputs have this family's shapes."""
        ...


FAMILIES: Mapping[str, DecoderClass] = {
    "yolox": YoloxDecoder,
    "yolov8": YoloV8Decoder,
    "yolov5": YoloV5Decoder,
    "yolo-end-to-end": YoloEndToEndDecoder,
    "rtdetr": RtDetrDecoder,
    "rtdetr-ultralytics": UltralyticsRtDetrDecoder,
    "detr-deploy": DetrDeployDecoder,
    "nanodet": NanoDetDecoder,
    "fastestdet": FastestDetDecoder,
    "yolov2": YoloV2Decoder,
}


def make_decoder(layout: NetworkLayout, family: str | None = None) -> Decoder:
    """Return the decoder for a network, of the family named or of the one whose shapes it has.

    Raises:
        ValueError: there is no such family, or the network is of none or of another.
    """
    if family is not None and family not in FAMILIES:
        raise ValueError(f"no family {family!r}; there are {', '.join(FAMILIES)}")
    wanted = list(FAMILIES) if family is None else [family]
    for name in wanted:
        if FAMILIES[name].fits(layout):
            return FAMILIES[name](layout)
    known = "; ".join(f"{name} {FAMILIES[name].layout}" for name in wanted)
    raise ValueError(
        f"not a detector of the family {' or '.join(wanted)}: {layout}; what is read: {known}"
    )
