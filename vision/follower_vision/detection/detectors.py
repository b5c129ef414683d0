"""The detectors by name."""

import math
from collections.abc import Iterable, Iterator, Sequence
from numbers import Integral
from pathlib import Path
from typing import Any

import numpy as np

from follower_vision.detection.detection import Detection, Detector
from follower_vision.detection.onnx_detector import OnnxDetector
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.models.store import ModelStore
from follower_vision.models.table import Purpose, VisionModel
from follower_vision.onnx_network import CPU, ModelError, path_of
from follower_vision.plugins import SURE, Plugin, PluginError, PluginGroup, PluginGuard

EMBEDDED = "embedded"
"""Another name for the detector that is part of this package."""
DETECTOR_PLUGINS = PluginGroup("follower.detectors", "detector", ("class_names", "detect"))
"""Each makes a `Detector` when it is called with what finds a file, and the device's name."""
_LARGE_PX = 600
_PART = 0.6
_SAME_IOU = 0.45
_SAME_INSIDE = 0.7


def detector_names(store: ModelStore) -> list[str]:
    """Return the names of the detectors in the table, there or not, and of other packages'."""
    ours = [model.name for model in store.models if model.purpose is Purpose.DETECTOR]
    taken = [EMBEDDED, *(model.name for model in store.models)]
    return [*ours, *DETECTOR_PLUGINS.names(taken)]


def make_detector(name: str, store: ModelStore, device: str = CPU) -> Detector:
    """Return a detector from the table, another package's, or one in the user's own ONNX file.

    Args:
        name: one of `detector_names`, "embedded", or a path that ends in .onnx.
        store: where the networks lie.
        device: where it runs; see `device`.

    Raises:
        ModelError: there is no such detector, or its file is missing or broken.
        PluginError: another package's detector cannot be used.
    """
    if (network := _network(name, store)) is None:
        return _added(name, store, device)
    path, family = network
    return OnnxDetector(path, family=family, device=device)


def network_file(name: str, store: ModelStore) -> Path | None:
    """Return the network that `make_detector` loads for a name, None for another package's.

    Raises:
        ModelError: it is missing, or no detector.
    """
    network = _network(name, store)
    return None if network is None else network[0]


def _network(name: str, store: ModelStore) -> tuple[Path, str | None] | None:
    """Return a detector's file, and its family if the table knows it."""
    path = path_of(name)
    if path.suffix == ".onnx":
        return path, None
    if name != EMBEDDED and all(model.name != name for model in store.models):
        return None
    model = _embedded(store) if name == EMBEDDED else store.model(name)
    if model.purpose is not Purpose.DETECTOR:
        raise ModelError(f"{name} is no detector; there are {', '.join(detector_names(store))}")
    return store.paths(model)[0], model.family


class GuardedDetector:
    """Asks a plug-in's detector; where that raises or errs, it detects nothing.

    Attributes:
        class_names: the detector's own.

    Raises:
        PluginError: these are no names.
    """

    def __init__(self, detector: Detector, plugin: Plugin) -> None:
        names: Any = detector.class_names
        self._detector = detector
        self._guard = PluginGuard(plugin)
        self.class_names = tuple(names) if isinstance(names, Iterable) else (names,)
        if not all(isinstance(name, str) for name in self.class_names):
            raise PluginError(f"the {plugin} is none: its class_names are {names}, not names")

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
        """See `Detector`."""

        def ask() -> list[Detection]:
            return as_detections(self._detector.detect(image, region), self.class_names)

        return self._guard.run(ask, [], lambda found: all(map(_is_detection, found)))


def as_detections(answer: Any, class_names: Sequence[str]) -> list[Detection]:
    """Return a detector's answer as it is, or one shaped as `supervision.Detections`.

    That has arrays over N objects: `xyxy` (N, 4) in pixels of the whole image; `confidence` (N,),
    taken as 1 where there is none, as a tracker's; `class_id` (N,), likewise 0; `mask`
    (N, H, W) of a segmentation, whose bounds then are the boxes; `tracker_id` (N,) of a
    multi-object tracker, by which objects without a track are left out. Fusion chooses by how
    things look and move, so that a track's number is no proof and goes no further.

    Args:
        answer: of the detector.
        class_names: by number.

    Raises:
        ValueError: the arrays do not fit.
    """
    if not hasattr(answer, "xyxy"):
        return answer  # type: ignore[no-any-return]
    corners = np.asarray(answer.xyxy, np.float64).reshape(-1, 4)
    masks, numbers = getattr(answer, "mask", None), getattr(answer, "tracker_id", None)
    scores = _given(answer, "confidence", np.ones(len(corners)))
    classes = _given(answer, "class_id", np.zeros(len(corners), int))
    found = []
    for row, (left, top, right, bottom) in enumerate(corners.tolist()):
        if numbers is not None and (numbers[row] is None or numbers[row] < 0):
            continue
        if masks is not None and np.any(masks[row]):
            left, right = _bounds(np.any(masks[row], axis=0))
            top, bottom = _bounds(np.any(masks[row], axis=1))
        if right <= left or bottom <= top:
            continue  # one without area says nothing of the others
        number = int(classes[row])
        name = class_names[number] if 0 <= number < len(class_names) else str(number)
        box = Box.from_xywh(left, top, right - left, bottom - top)
        found.append(Detection(box, number, name, float(scores[row])))
    return sorted(found, key=lambda one: -one.score)


def _given(answer: Any, name: str, usual: Any) -> Any:
    values = getattr(answer, name, None)
    if values is None:
        return usual
    if len(values) != len(usual):
        raise ValueError(f"{name} has {len(values)} rows, xyxy {len(usual)}")
    return values


def _bounds(filled: Any) -> tuple[float, float]:
    """Return where the first filled pixel begins and the last one ends."""
    places = np.flatnonzero(filled)
    return float(places[0]), float(places[-1]) + 1.0


def _is_detection(one: Detection) -> bool:
    sound = isinstance(one, Detection) and isinstance(one.box, Box)
    named = sound and isinstance(one.class_id, Integral) and isinstance(one.class_name, str)
    return named and math.isfinite(one.score) and one.score <= SURE


def _added(name: str, store: ModelStore, device: str) -> GuardedDetector:
    """Return the detector that another package adds."""
    plugin = DETECTOR_PLUGINS.find(name)
    if plugin is None:
        names = ", ".join(detector_names(store))
        raise ModelError(f"there is no network {name!r}; there are {names}")
    return GuardedDetector(plugin.make(store.file, device), plugin)


def _embedded(store: ModelStore) -> VisionModel:
    for model in store.models:
        if model.embedded and model.purpose is Purpose.DETECTOR:
            return model
    raise ModelError("no detector is part of this package")


def scan(detector: Detector, image: Image) -> list[Detection]:
    """Return what the detector sees in an image and, if it is large, in its four enlarged parts.

    The parts overlap. What a part's edge cuts is left to the others and to the whole image; of two
    boxes of one class about the same object the better stays.

    Args:
        detector: any.
        image: (H, W, 3) uint8 BGR.

    Returns:
        Detections, best first.
    """
    found = detector.detect(image)
    if max(image.shape[:2]) >= _LARGE_PX:
        for part in parts(image.shape[1], image.shape[0]):
            found = [*found, *(one for one in detector.detect(image, part) if not one.cut)]
    return _without_doubles(found)


def parts(width: int, height: int) -> Iterator[Box]:
    """Yield four regions of an image, in pixels, that overlap and cover it."""
    across, down = _PART * width, _PART * height
    for left in (0.0, width - across):
        for top in (0.0, height - down):
            yield Box.from_xywh(left, top, across, down)


def _without_doubles(found: Sequence[Detection]) -> list[Detection]:
    kept: list[Detection] = []
    for one in sorted(found, key=lambda detection: -detection.score):
        if not any(_same(one, other) for other in kept):
            kept.append(one)
    return kept


def _same(one: Detection, other: Detection) -> bool:
    if one.class_id != other.class_id:
        return False
    shared = one.box.intersection(other.box)
    inside = shared / min(one.box.area, other.box.area)
    return one.box.iou(other.box) > _SAME_IOU or inside > _SAME_INSIDE
