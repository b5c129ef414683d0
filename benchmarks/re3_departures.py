"""What each part of our Re3 is worth, with the same weights: each is left out in turn.

    python benchmarks/re3_departures.py WEIGHTS.onnx FOLDER [FOLDER ...] [--only NAME,NAME]

FOLDER holds sequences as `follower evaluate` reads them. The network was trained as a whole: a
part left out is missed by the others, so that a network trained without it might lose less.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import command_line
import cv2
import numpy as np

from follower_vision.evaluation.datasets import load_dataset
from follower_vision.evaluation.one_pass import Sequence
from follower_vision.trackers.motion_tracker import IdentityTracker, MotionTracker
from follower_vision.trackers.re3 import (
    Re3Memory,
    Re3Network,
    Re3Output,
    Re3Settings,
    Re3Tracker,
)

NEVER = 1_000_000


class WithoutMemory(Re3Network):
    """Knows the target from the frame before alone, as the paper's network (and GOTURN) does."""

    def predict(self, *look: Any) -> Re3Output:
        """Look with the features of the frame before as memory."""
        view, image, box, fill, _, state = look
        seen = super().predict(*look).features
        ratios = np.array([[box.width / box.scale, box.height / box.scale]], np.float32)
        return super().predict(view, image, box, fill, Re3Memory(seen, ratios), state)


class WithoutRecurrence(Re3Network):
    """Both LSTM layers stay as they were before the first frame."""

    def predict(self, *look: Any) -> Re3Output:
        """Look with no state."""
        view, image, box, fill, memory, _ = look
        return super().predict(view, image, box, fill, memory, self.first_state)


class ConstantSize(Re3Network):
    """Its box never grows: a tracker that only finds places, as the first SiamFC's one scale."""

    def predict(self, *look: Any) -> Re3Output:
        """Look, and leave the size alone."""
        output = super().predict(*look)
        kept = output.box * np.array([1, 1, 0, 0], np.float32)
        return replace(output, box=kept)


def variants(weights: Path) -> dict[str, MotionTracker]:
    """Return the trackers to compare, by name."""
    whole = Re3Network(weights)
    return {
        "identity": IdentityTracker(),
        "whole": Re3Tracker(whole),
        "without memory of the first frame": Re3Tracker(WithoutMemory(weights)),
        "without recurrence": Re3Tracker(WithoutRecurrence(weights)),
        "size kept": Re3Tracker(ConstantSize(weights)),
        "reset after 8 frames": Re3Tracker(whole, Re3Settings(reset_frames=8)),
        "reset after 128 frames": Re3Tracker(whole, Re3Settings(reset_frames=128)),
        "never reset": Re3Tracker(whole, Re3Settings(reset_frames=NEVER)),
    }


def main() -> None:
    """Measure and print a row a variant."""
    parser = command_line.parser(__doc__)
    parser.add_argument("weights", type=Path)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--only", help="names apart by commas", default="")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    sequences = [one for folder in options.folders for one in load_dataset(folder)[0]]
    wanted = [name for name in options.only.split(",") if name]
    print(f"{'variant':36} success@0.5  mean overlap  ms   ({len(sequences)} sequences)")
    for name, tracker in variants(options.weights).items():
        if not wanted or name in wanted:
            success, overlap, ms = np.mean([_measured(tracker, one) for one in sequences], axis=0)
            print(f"{name:36} {success:11.3f}  {overlap:12.3f}  {ms:.2f}", flush=True)


def _measured(tracker: MotionTracker, sequence: Sequence) -> tuple[float, float, float]:
    frames, boxes, update_s = sequence.frames(), [], []
    tracker.start(next(frames), sequence.initial)
    for image in frames:
        begin_s = time.perf_counter()
        boxes.append(tracker.update(image).box)
        update_s.append(time.perf_counter() - begin_s)
    pairs = zip(boxes, sequence.truth[1:], strict=True)
    overlaps = np.array([box.iou(truth) for box, truth in pairs if truth is not None])
    ms = 1000 * float(np.median(update_s))
    return float((overlaps > 0.5).mean()), float(overlaps.mean()), ms


if __name__ == "__main__":
    command_line.run(main)
