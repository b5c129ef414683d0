"""The motion trackers that come along follow a target, on a machine that has fetched nothing."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from follower_vision.geometry.box import Box
from follower_vision.models import MODELS, ModelStore
from follower_vision.models.store import EMBEDDED_FOLDER
from follower_vision.trackers.motion_tracker import MotionTracker
from follower_vision.trackers.re3 import Re3Network
from follower_vision.trackers.registry import RE3_FILE, make_tracker

_MOST_BYTES = 8_000_000
GROUND = cv2.resize(
    np.random.default_rng(5).integers(60, 180, (60, 80, 3), dtype=np.uint8), (640, 480)
)
PATCH = np.random.default_rng(6).integers(0, 256, (5, 5, 3), dtype=np.uint8)


@pytest.fixture(params=["re3", "siamese", "siamese-correlation"])
def tracker(request: pytest.FixtureRequest, tmp_path: Path) -> MotionTracker:
    return make_tracker(request.param, ModelStore(tmp_path / "nothing").file)


def scene(box: Box) -> np.ndarray:
    image = GROUND.copy()
    x, y, width, height = (round(value) for value in box.xywh)
    image[y : y + height, x : x + width] = cv2.resize(PATCH, (width, height))
    return image


def test_it_follows_a_patch_that_moves_and_grows(tracker: MotionTracker) -> None:
    overlaps = []
    for frame in range(60):
        truth = Box(150 + 5 * frame, 200 + 40 * np.sin(frame / 8), 50 + 0.4 * frame, 40)
        if frame == 0:
            tracker.start(scene(truth), truth)
        else:
            overlaps.append(tracker.update(scene(truth)).box.iou(truth))
    assert np.mean(overlaps) > 0.65
    assert min(overlaps) > 0.4


def test_it_is_sure_of_what_it_sees_and_less_of_what_has_gone(tracker: MotionTracker) -> None:
    box = Box(300, 200, 50, 40)
    tracker.start(scene(box), box)
    seen = [tracker.update(scene(box)).confidence for _ in range(5)]
    gone = [tracker.update(GROUND).confidence for _ in range(5)]
    assert min(seen) > max(gone)


def test_what_it_remembers_matters(tmp_path: Path) -> None:
    network = Re3Network(ModelStore(tmp_path).file(RE3_FILE))
    box, fill = Box(300, 200, 50, 40), (0.0, 0.0, 0.0)
    memory, state = network.learn(scene(box), box, fill)
    assert np.abs(state.hidden).mean(axis=(1, 2)).min() > 1e-4  # no layer is shut
    moved = scene(Box(306, 203, 50, 40))
    view = network.view(scene(box), box, fill)
    known = network.predict(view, moved, box, fill, memory, state)
    unknown = network.predict(view, moved, box, fill, memory, network.first_state)
    assert np.abs(known.box - unknown.box).max() > 1e-6


def test_all_weights_together_stay_small() -> None:
    files = [file for model in MODELS if model.embedded for file in model.files]
    assert {file.name for file in files} == {path.name for path in EMBEDDED_FOLDER.glob("*.onnx")}
    assert sum(file.size_bytes for file in files) <= _MOST_BYTES
