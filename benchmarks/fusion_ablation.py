"""What each part of Fusion is worth: success and precision on real sequences.

    python benchmarks/fusion_ablation.py DATA [--only NAME,NAME] [--starts 3] [--variants all]
        [--late SECONDS]

DATA holds `sequences` and `weights`. Variants: "fusion", "paper", or an improvement's name, which
is then switched off; "all" is everything. The first start is the true box, the others are jittered
(place by 4 % of the side, size by 4 %, one sigma, seeds 1001, 1002 ...). With `--late`, detection
is in the background, beside a camera of 30 frames a second, and each answer comes so many seconds
late, in simulated time.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from late_detection import LateDetection

from follower_vision.box import Box
from follower_vision.clock import SimulatedClock
from follower_vision.detection.onnx_detector import OnnxDetector
from follower_vision.frame import Frame
from follower_vision.fusion import FusionSettings, FusionTracker, InlineDetection
from follower_vision.fusion.settings import IMPROVEMENTS
from follower_vision.models import ModelStore
from follower_vision.trackers import make_tracker

RATE_HZ = 30.0
JITTER = 0.04
PRECISE_PX = 20.0


def main() -> None:
    """Measure and print a row a variant."""
    options = _options()
    weights = options.data / "weights"
    motion = make_tracker(options.tracker, ModelStore(weights).file)
    detector = OnnxDetector(weights / options.detector)
    print(f"{'variant':20} success (least-most of the starts)  precision  tracking at IoU 0")
    for variant in _variants(options.variants):
        clock = SimulatedClock()
        late = partial(LateDetection, clock=clock, late_s=options.late or 0.0)
        mode = InlineDetection if options.late is None else late
        tracker = FusionTracker(motion, detector, _settings(variant), mode)
        scores = np.array(
            [
                [_score(tracker, clock, folder, start) for folder in _folders(options)]
                for start in range(options.starts)
            ]
        ).mean(axis=1)
        mean, success = scores.mean(axis=0), scores[:, 0]
        spread = f"({success.min():.3f}-{success.max():.3f})"
        print(
            f"{variant:20} {mean[0]:.3f} {spread:30} {mean[1]:.3f}      {mean[2]:.4f}", flush=True
        )


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--only", default="", help="parts of the sequences' names")
    parser.add_argument("--starts", type=int, default=3)
    parser.add_argument("--variants", default="fusion")
    parser.add_argument("--tracker", default="nanotrack-v3")
    parser.add_argument("--detector", default="yolox_nano_bi.onnx")
    parser.add_argument("--late", type=float, help="seconds until a detection's answer comes")
    return parser.parse_args()


def _variants(text: str) -> list[str]:
    return ["fusion", "paper", *IMPROVEMENTS] if text == "all" else text.split(",")


def _settings(variant: str) -> FusionSettings:
    if variant == "paper":
        return FusionSettings.paper()
    return FusionSettings() if variant == "fusion" else FusionSettings().without(variant)


def _folders(options: argparse.Namespace) -> list[Path]:
    wanted = options.only.split(",")
    folders = sorted((options.data / "sequences").iterdir())
    return [folder for folder in folders if any(part in folder.name for part in wanted)]


def _score(
    tracker: FusionTracker, clock: SimulatedClock, folder: Path, start: int
) -> tuple[float, float, float]:
    """Success, precision, and the share of frames called TRACKING without any overlap."""
    lines = (folder / "groundtruth.txt").read_text().split()
    truth = [[float(value) for value in line.split(",")] for line in lines]
    paths = sorted((folder / "img").iterdir())[: len(truth)]
    tracker.start(_frame(paths[0], 0), _jittered(Box.from_xywh(*truth[0]), start))
    rows, began_s = [], clock.now()
    for number, path in enumerate(paths[1:], 1):
        clock.sleep_until(began_s + number / RATE_HZ)
        track = tracker.step(_frame(path, number))
        if truth[number][2] > 0 and truth[number][3] > 0:
            box = Box.from_xywh(*truth[number])
            overlap, away = track.box.iou(box), track.box.distance(box)
            lie = overlap == 0 and track.state == "tracking"
            rows.append((overlap > 0.5, away <= PRECISE_PX, lie))
    success, precision, lies = np.mean(rows, axis=0)
    return float(success), float(precision), float(lies)


def _frame(path: Path, number: int) -> Frame:
    return Frame(np.asarray(cv2.imread(str(path)), np.uint8), number / RATE_HZ, number)


def _jittered(box: Box, start: int) -> Box:
    if start == 0:
        return box
    rng = np.random.default_rng(1000 + start)
    right, down = rng.normal(0, JITTER, 2)
    wider, taller = np.exp(rng.normal(0, JITTER, 2))
    return Box(
        box.cx + right * box.width,
        box.cy + down * box.height,
        box.width * wider,
        box.height * taller,
    )


if __name__ == "__main__":
    main()
