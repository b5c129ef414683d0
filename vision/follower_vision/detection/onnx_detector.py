"""Object detection by an ONNX network of any known family."""

import ast
import json
import math
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path

import numpy as np

from follower_vision.detection.detection import (
    Candidates,
    Detection,
    DetectorSettings,
    NetworkLayout,
)
from follower_vision.detection.families import make_decoder
from follower_vision.geometry.box import Box, keep_best, lies_in
from follower_vision.images.crop import crop
from follower_vision.images.frame import Image
from follower_vision.onnx_network import (
    CPU,
    Integers,
    ModelError,
    Network,
    Tensor,
    usual_shape,
)

_CANDIDATES_A_DETECTION = 5
_EDGE_PX = 2.0
"""How near to the region's edge a box counts as cut, in pixels of the network's input."""
_OTHER_TASKS = ("segment", "pose", "obb", "classify")
"""Of Ultralytics' networks; some answer in a detector's shapes, with angles or joints as scores."""


def _names_in(file: str) -> tuple[str, ...]:
    """Return the names in a file of this package, one a line, in the order of darknet."""
    return tuple((resources.files(__package__) / file).read_text("utf-8").splitlines())


VOC_CLASSES = _names_in("voc.names")
COCO_CLASSES = _names_in("coco.names")


def choose_class_names(
    count: int, given: Sequence[str] | None, metadata: Mapping[str, str]
) -> tuple[str, ...]:
    """Return the names: those given, else those in the file, else the usual for their number.

    A `count` of 0 is not known: any number of names is taken then, and COCO's if there are none.

    Raises:
        ValueError: there are more or fewer names given than classes.
    """
    if given is not None:
        if count not in (0, len(given)):
            raise ValueError(f"{len(given)} class names were given for {count} classes")
        return tuple(given)
    written = _written_names(metadata.get("names", ""))
    if written and count in (0, len(written)):
        return written
    usual = {0: COCO_CLASSES, 80: COCO_CLASSES, 20: VOC_CLASSES}
    return usual.get(count) or tuple(f"class {number}" for number in range(count))


def _written_names(text: str) -> tuple[str, ...]:
    """Read a list or a numbered table of names, as exporters write them; () if it is neither."""
    try:
        names = ast.literal_eval(text.strip())
    except (ValueError, SyntaxError):
        return ()
    if isinstance(names, dict):
        names = [names.get(number) for number in range(len(names))]
    if not isinstance(names, list | tuple):
        return ()
    return tuple(str(name) for name in names)


class OnnxDetector:
    """Finds objects with a network of any of the families of `families.FAMILIES`.

    One thread at a time may call `detect`: the input's memory is used again and again.

    Attributes:
        path: the ONNX file.
        class_names: the names of all classes, by their numbers.
    """

    def __init__(
        self,
        path: Path,
        settings: DetectorSettings | None = None,
        *,
        family: str | None = None,
        class_names: Sequence[str] | None = None,
        device: str = CPU,
    ) -> None:
        """Load a network and try it on a blank image.

        Args:
            path: the ONNX file.
            settings: which answers count.
            family: a key of `FAMILIES`; None recognises it by the shapes of the answers.
            class_names: None takes those written in the file, or COCO's or VOC's.
            device: where it runs; see `device`.

        Raises:
            ModelError: the file is missing, broken or of no known family.
            ValueError: the number of class names is not that of the classes.
        """
        self.path = path
        self._settings = settings or DetectorSettings()
        self._network = Network(path, device)
        self._tensor = np.zeros(_input_shape(self._network), np.float32)
        self._size = _size_input(self._network, self._tensor)
        try:
            layout = _layout(self._network, self._tensor, self._size)
            self._decoder = make_decoder(layout, family)
        except ValueError as error:
            raise ModelError(f"{path}: {error}") from error
        self.class_names = choose_class_names(
            self._decoder.classes, class_names, self._network.metadata
        )

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
        """Return the objects in an image, or in a region of it, best first.

        Args:
            image: (H, W, 3) uint8 BGR.
            region: search only here, enlarged to the network's input; None is the whole image. It
                may reach beyond the image. An object counts where its centre lies in the region.
        """
        whole = _whole(image)
        height, width = self._tensor.shape[2:]
        view = self._decoder.input_format.view(region or whole, width, height)
        self._show(image, view)
        outputs = self._network.run(self._tensor, *self._size)
        found = self._decoder.decode(outputs, self._settings.min_score)
        detections = self._detections(self._thinned(found.valid()), view, whole)
        return [one for one in detections if lies_in(one.box, region)]

    def _show(self, image: Image, view: Box) -> None:
        """Write the view into the input."""
        height, width = self._tensor.shape[2:]
        fill = [self._decoder.input_format.fill] * 3
        self._decoder.input_format.write(crop(image, view, width, height, fill), self._tensor)

    def _thinned(self, found: Candidates) -> Candidates:
        """Keep the best of the boxes of one class that overlap, and no more than asked for."""
        few = self._settings.most * _CANDIDATES_A_DETECTION
        best = np.argsort(-found.scores, kind="stable")[:few]
        # Boxes of different classes are moved apart, so that they cannot overlap.
        apart = found.classes[best, None] * (2.0 * float(np.ptp(found.corners)) if best.size else 0)
        corners = found.corners[best] + apart
        kept = keep_best(
            corners, found.scores[best], self._settings.max_overlap, self._settings.most
        )
        chosen = best[kept]
        return Candidates(found.corners[chosen], found.scores[chosen], found.classes[chosen])

    def _detections(self, found: Candidates, view: Box, whole: Box) -> list[Detection]:
        height, width = self._tensor.shape[2:]
        scale = np.array([view.width / width, view.height / height] * 2)
        corners = found.corners * scale + np.array([view.left, view.top] * 2)
        cut = self._cut(corners, view, whole)
        made = []
        for (left, top, right, bottom), score, number, is_cut in zip(
            corners.tolist(), found.scores.tolist(), found.classes.tolist(), cut, strict=True
        ):
            box = Box((left + right) / 2, (top + bottom) / 2, right - left, bottom - top)
            made.append(Detection(box, number, self._name(number), score, is_cut))
        return made

    def _name(self, number: int) -> str:
        known = 0 <= number < len(self.class_names)
        return self.class_names[number] if known else f"class {number}"

    def _cut(self, corners: Tensor, view: Box, whole: Box) -> list[bool]:
        """Return for each box whether it ends where the view ends and the image does not."""
        near = _EDGE_PX * view.width / self._tensor.shape[3]
        inside = [view.left > 0, view.top > 0, view.right < whole.right, view.bottom < whole.bottom]
        at_edge = np.stack(
            [
                corners[:, 0] <= view.left + near,
                corners[:, 1] <= view.top + near,
                corners[:, 2] >= view.right - near,
                corners[:, 3] >= view.bottom - near,
            ],
            axis=1,
        )
        return [bool(one) for one in (at_edge & np.array(inside)).any(axis=1)]


def _whole(image: Image) -> Box:
    height, width = image.shape[:2]
    return Box(width / 2, height / 2, width, height)


def _input_shape(network: Network) -> tuple[int, ...]:
    """Return the input's shape, with the usual side where the network takes any."""
    shapes = list(network.inputs.values())
    with_size = len(shapes) == 2 and shapes[1][1:] == (2,) and network.kinds[1] is not np.float32
    takes_one = len(shapes) == 1 or with_size
    if not takes_one or len(shapes[0]) != 4 or shapes[0][0] > 1 or shapes[0][1] not in (0, 3):
        raise ModelError(
            f"{network.path}: not a detector of single images: its inputs are {shapes}"
        )
    return usual_shape(shapes[0])


def _size_input(network: Network, tensor: Tensor) -> list[Integers]:
    """Return what a second input takes: the size in which boxes are wanted, the input's own."""
    height, width = tensor.shape[2:]
    return [np.array([[width, height]], kind) for kind in network.kinds[1:]]


def _layout(network: Network, blank: Tensor, size: list[Integers]) -> NetworkLayout:
    """Try a network on a blank image, because not every file states its outputs' shapes."""
    task = network.metadata.get("task", "")
    if task in _OTHER_TASKS:
        raise ValueError(f"not a detector of upright boxes: its task is {task}")
    shapes = [output.shape for output in network.run(blank, *size)]
    outputs = tuple(zip(network.outputs, shapes, strict=True))
    anchors = _written_anchors(network)
    head = network.metadata.get("head", "")
    return NetworkLayout(blank.shape[2], blank.shape[3], outputs, anchors, head)


def _written_anchors(network: Network) -> tuple[tuple[float, float], ...]:
    """Read widths and heights as a list of pairs, as `follower train detector` writes them."""
    text = network.metadata.get("anchors", "[]")
    try:
        pairs = [(float(width), float(height)) for width, height in json.loads(text)]
    except (ValueError, TypeError):
        raise ModelError(f"{network.path}: its anchors are no list of pairs: {text}") from None
    if not all(0 < side < math.inf for pair in pairs for side in pair):
        raise ModelError(f"{network.path}: its anchors are not positive: {text}")
    return tuple(pairs)
