"""By what power of Re3's likelihood a fifth less than usual is as likely a loss as not.

    follower train sequences generated/ --stock runs/train/follower-re3/stock
    python benchmarks/re3_confidence.py generated/ [generated/ ...] [--weights WEIGHTS.onnx]

Fusion takes a confidence below 0.8 of the target's usual one for a loss. Re3 follows each sequence
without help; each frame gives the likelihood as a share of the usual one, measured as Fusion does,
and whether the box has anything of the target: a loose box is no loss. A logistic curve says at
which share every second box is lost; its power that is 0.8 is printed (`Re3Settings`).
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from follower_vision.datasets import load_dataset
from follower_vision.fusion.settings import FusionSettings
from follower_vision.fusion.trust import Trust
from follower_vision.ope import Sequence, read_image
from follower_vision.re3 import Re3Tracker
from follower_vision.re3_network import Re3Network
from follower_vision.re3_settings import Re3Settings

WEIGHTS = Path("vision/follower_vision/weights/follower-re3.onnx")
MEMORY_S = 1.0
FRAME_S = 1 / 30
LOST_SHARE = FusionSettings().low_ratio


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--weights", type=Path, default=WEIGHTS)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    network = Re3Network(options.weights)
    sequences = [one for folder in options.folders for one in load_dataset(folder)[0]]
    pairs = [pair for one in sequences for pair in shares(network, one)]
    share, found = (np.array(column, float) for column in zip(*pairs, strict=True))
    for least in np.arange(0.2, 1.0, 0.1):
        there = (share >= least) & (share < least + 0.1)
        if there.any():
            print(
                f"{least:.1f} of the usual: {there.sum():5} boxes, {found[there].mean():.2f} found"
            )
    half = even_odds(share, found)
    power = math.log(LOST_SHARE) / math.log(half)
    print(f"every second box is lost at {half:.2f}: power {power:.2f}")


def shares(network: Re3Network, sequence: Sequence) -> Iterator[tuple[float, bool]]:
    """Yield the likelihood as a share of the usual one, and whether the box is a loss or not."""
    tracker, trust = (
        Re3Tracker(network, Re3Settings(confidence_power=1.0)),
        Trust(MEMORY_S, MEMORY_S),
    )
    images, truth = map(read_image, sequence.images), sequence.truth
    assert truth[0] is not None
    tracker.start(next(images), truth[0])
    for image, true in zip(images, truth[1:], strict=True):
        estimate = tracker.update(image)
        share = trust.relative(estimate.confidence)
        if share > LOST_SHARE:
            trust.learn(estimate.confidence, FRAME_S)
        if true is not None:
            yield share, estimate.box.iou(true) > 0


def even_odds(share: np.ndarray, found: np.ndarray) -> float:
    """Return at which share found and lost are equally likely, by a logistic curve in its log."""
    inputs = np.stack([np.log(np.maximum(share, 1e-3)), np.ones_like(share)], axis=1)
    weights = np.zeros(2)
    for _ in range(50):
        likely = 1.0 / (1.0 + np.exp(-np.clip(inputs @ weights, -30, 30)))
        curve = (inputs * (likely * (1.0 - likely))[:, None]).T @ inputs
        weights += np.linalg.solve(curve + 1e-6 * np.eye(2), inputs.T @ (found - likely))
    return float(np.exp(-weights[1] / weights[0]))


if __name__ == "__main__":
    main()
