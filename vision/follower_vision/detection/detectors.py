"""The detectors by name."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from follower_vision.detection.onnx_detector import OnnxDetector
from follower_vision.detection.settings import DetectorSettings
from follower_vision.models.model import Model, Purpose
from follower_vision.models.store import ModelStore
from follower_vision.network import ModelError

EMBEDDED = "embedded"
"""Another name for the detector that is part of this package."""


def detector_names(store: ModelStore) -> list[str]:
    """Return the names of the detectors in the table, there or not."""
    return [model.name for model in store.models if model.purpose is Purpose.DETECTOR]


def make_detector(
    name: str,
    store: ModelStore,
    settings: DetectorSettings | None = None,
    *,
    family: str | None = None,
    class_names: Sequence[str] | None = None,
    threads: int = 1,
) -> OnnxDetector:
    """Return a detector from the table, or from the user's own ONNX file.

    Args:
        name: one of `detector_names`, "embedded", or a path that ends in .onnx.
        store: where the networks lie.
        settings: which answers count.
        family: how the answer is read; None asks the table, or the shapes of the answer.
        class_names: None takes those in the file, or COCO's or VOC's.
        threads: processor threads that one detection may use.

    Raises:
        ModelError: there is no such detector, or its file is missing or broken.
    """
    path = Path(name).expanduser()
    if path.suffix != ".onnx":
        model = _embedded(store) if name == EMBEDDED else store.model(name)
        if model.purpose is not Purpose.DETECTOR:
            raise ModelError(f"{name} is no detector; there are {', '.join(detector_names(store))}")
        path, family = store.paths(model)[0], family or model.family
    return OnnxDetector(path, settings, family=family, class_names=class_names, threads=threads)


def _embedded(store: ModelStore) -> Model:
    for model in store.models:
        if model.embedded and model.purpose is Purpose.DETECTOR:
            return model
    raise ModelError("no detector is part of this package")
