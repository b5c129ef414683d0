"""How fast Fusion is beside its motion tracker alone: inline, in the background, and our own part.

    python benchmarks/fusion_speed.py [DATA] [--cores 1|2] [--sequence NAME] [--frames N]

Frames are decoded beforehand; every network has one thread. DATA holds `sequences` and `weights`.
The motion tracker alone and both modes of Fusion run in turns over the same frames, because other
programs on the machine change its speed. Promises on two cores at 1280x720, in the background: at
least 86 frames a second, at least 0.72 of the motion tracker alone, and no frame waits for a
detection.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from follower_vision.box import Box
from follower_vision.detection.detection import Detection, Detector
from follower_vision.detection.onnx_detector import OnnxDetector
from follower_vision.frame import Frame, Image
from follower_vision.fusion import BackgroundDetection, FusionTracker, InlineDetection
from follower_vision.motion import MotionEstimate
from follower_vision.nanotrack import NanoTracker
from follower_vision.trackers import make_tracker

RATE_HZ = 30.0


class TimedTracker:
    """A NanoTracker that adds up its own time."""

    name = "timed"

    def __init__(self, tracker: NanoTracker) -> None:
        self._tracker = tracker
        self.busy_s = 0.0

    def start(self, image: Image, box: Box) -> None:
        """Start the tracker."""
        self._tracker.start(image, box)

    def move_to(self, box: Box) -> None:
        """Send the tracker elsewhere."""
        self._tracker.move_to(box)

    def update(self, image: Image) -> MotionEstimate:
        """Update the tracker."""
        began = time.perf_counter()
        estimate = self._tracker.update(image)
        self.busy_s += time.perf_counter() - began
        return estimate

    def probe(self, image: Image, box: Box) -> list[MotionEstimate]:
        """Look elsewhere."""
        began = time.perf_counter()
        places = self._tracker.probe(image, box)
        self.busy_s += time.perf_counter() - began
        return places


class TimedDetector:
    """A detector that adds up its own time."""

    def __init__(self, detector: Detector) -> None:
        self._detector = detector
        self.class_names = detector.class_names
        self.busy_s = 0.0
        self.calls = 0

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
        """Detect."""
        began = time.perf_counter()
        found = self._detector.detect(image, region)
        self.busy_s += time.perf_counter() - began
        self.calls += 1
        return found


def main() -> None:
    """Measure and print."""
    options = _options()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, set(sorted(os.sched_getaffinity(0))[: options.cores]))
    cv2.setNumThreads(1)
    frames, box = _frames(options.data / "sequences" / options.sequence, options.frames)
    tracker = make_tracker("nanotrack-v3", lambda name: options.data / "weights" / name)
    detector = OnnxDetector(options.data / "weights" / "yolox_nano_bi.onnx")
    print(f"{options.sequence}, {frames[0].width}x{frames[0].height}, {options.cores} core(s)")
    print(f"{'':12} {'frames/s':>9} {'median ms':>10} {'p99 ms':>8} {'own ms':>7}  detections")
    for turn in range(options.turns):
        alone = _alone(tracker, frames, box)
        _line("motion", alone, None, 0)
        for name, mode in (("inline", InlineDetection), ("background", BackgroundDetection)):
            timed, counted = TimedTracker(tracker), TimedDetector(detector)
            spent = _fused(FusionTracker(timed, counted, mode=mode), frames, box)
            networks_s = timed.busy_s + (counted.busy_s if mode is InlineDetection else 0.0)
            _line(name, spent, (sum(spent) - networks_s) / len(spent), counted.calls)
            print(f"{'':12} {sum(alone) / sum(spent):9.2f} of the motion tracker, turn {turn}")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = Path(__file__).resolve().parents[2] / "shared/data"
    parser.add_argument("data", nargs="?", type=Path, default=default)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--sequence", default="uav123_group2_2")
    parser.add_argument("--frames", type=int, default=280)
    parser.add_argument("--turns", type=int, default=3)
    return parser.parse_args()


def _frames(folder: Path, most: int) -> tuple[list[Frame], Box]:
    paths = sorted((folder / "img").iterdir())[:most]
    images = [np.asarray(cv2.imread(str(path)), np.uint8) for path in paths]
    first = (folder / "groundtruth.txt").read_text().splitlines()[0]
    box = Box.from_xywh(*(float(value) for value in first.replace("\t", ",").split(",")))
    return [Frame(image, i / RATE_HZ, i) for i, image in enumerate(images)], box


def _alone(tracker: NanoTracker, frames: list[Frame], box: Box) -> list[float]:
    tracker.start(frames[0].image, box)
    return _timed(lambda frame: tracker.update(frame.image), frames)


def _fused(fusion: FusionTracker, frames: list[Frame], box: Box) -> list[float]:
    fusion.start(frames[0], box)
    spent = _timed(fusion.step, frames)
    fusion.close()
    return spent


def _timed(step: Callable[[Frame], object], frames: list[Frame]) -> list[float]:
    spent = []
    for frame in frames[1:]:
        began = time.perf_counter()
        step(frame)
        spent.append(time.perf_counter() - began)
    return spent


def _line(name: str, spent: list[float], own_s: float | None, detections: int) -> None:
    median, late = (1000 * float(np.percentile(spent, share)) for share in (50, 99))
    own = "" if own_s is None else f"{1000 * own_s:7.2f}"
    rate = len(spent) / sum(spent)
    print(f"{name:12} {rate:9.1f} {median:10.2f} {late:8.2f} {own:>7}  {detections or ''}")


if __name__ == "__main__":
    main()
