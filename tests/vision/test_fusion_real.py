"""Fusion with real networks on real sequences."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest
from real_data import DATA, needs_data

from follower_vision.detection.onnx_detector import OnnxDetector
from follower_vision.fusion import FusionTracker, MultiFusion
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.trackers.registry import make_tracker
from follower_vision.trackers.track import Track, TrackState

pytestmark = [pytest.mark.slow, needs_data("weights", "sequences")]


def _weights(name: str) -> Path:
    return DATA / "weights" / name


def _sequence(name: str, most: int) -> tuple[list[Frame], list[Box | None]]:
    folder = DATA / "sequences" / name
    lines = (folder / "groundtruth.txt").read_text().split()
    values = [[float(v) for v in line.split(",")] for line in lines[:most]]
    truth = [Box.from_xywh(*v) if v[2] > 0 and v[3] > 0 else None for v in values]
    paths = sorted((folder / "img").iterdir())[:most]
    return [Frame(cv2.imread(str(p)), i / 30, i) for i, p in enumerate(paths)], truth


def _fusion() -> FusionTracker:
    detector = OnnxDetector(_weights("yolox_nano_bi.onnx"))
    return FusionTracker(make_tracker("nanotrack-v3", _weights), detector)


def _follow(frames: list[Frame], truth: list[Box | None]) -> list[Track]:
    tracker = _fusion()
    assert truth[0] is not None
    tracker.start(frames[0], truth[0])
    return [tracker.step(frame) for frame in frames[1:]]


@pytest.mark.parametrize("name", ["uav123_wakeboard7", "otb_crossing", "otb_jogging1"])
def test_follows_real_targets_and_says_so_honestly(name: str) -> None:
    frames, truth = _sequence(name, 120)
    tracks = _follow(frames, truth)
    pairs = [(t, b) for t, b in zip(tracks, truth[1:], strict=True) if b is not None]
    assert sum(t.box.iou(b) > 0.5 for t, b in pairs) >= 0.9 * len(pairs)
    wrong = sum(t.state is TrackState.TRACKING and t.box.iou(b) == 0 for t, b in pairs)
    assert wrong <= 0.03 * len(pairs)


def test_inline_is_the_same_bit_for_bit() -> None:
    frames, truth = _sequence("uav123_wakeboard7", 40)
    assert _follow(frames, truth) == _follow(frames, truth)


def test_two_people_are_followed_with_one_detector() -> None:
    frames, truth = _sequence("otb_jogging1", 60)
    second = Box.from_xywh(180, 85, 26, 100)
    multi = MultiFusion(
        lambda: make_tracker("nanotrack-v3", _weights), OnnxDetector(_weights("yolox_nano_bi.onnx"))
    )
    assert truth[0] is not None
    multi.start(frames[0], [truth[0], second])
    for frame, box in zip(frames[1:], truth[1:], strict=True):
        tracks = multi.step(frame)
        assert box is not None
        assert tracks[0].box.iou(box) > 0.4
        assert tracks[0].box.iou(tracks[1].box) < 0.3
    assert multi.passes <= len(frames)
