"""The curves of one-pass evaluation, and the starts of its robustness tests.

Success and precision, and the starts, after Wu, Lim and Yang, "Object Tracking Benchmark"
(PAMI 2015); normalised precision after Müller et al., "TrackingNet" (ECCV 2018).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from follower_vision.box import Box

SUCCESS_AT = np.linspace(0, 1, 21)
PRECISION_AT = np.arange(51.0)
NORMALISED_AT = np.linspace(0, 0.5, 51)


@dataclass(frozen=True, slots=True)
class OpeCurves:
    """Shares of the scored frames, one value a threshold.

    Attributes:
        success: intersection over union above SUCCESS_AT.
        precision: centre within PRECISION_AT pixels.
        normalised: centre within NORMALISED_AT of the true box's sides.
    """

    success: tuple[float, ...]
    precision: tuple[float, ...]
    normalised: tuple[float, ...]

    @property
    def normalised_precision(self) -> float:
        """The mean of the normalised curve: the area under it over its width."""
        return float(np.mean(self.normalised))


def ope_curves(boxes: Sequence[Box | None], truth: Sequence[Box | None]) -> OpeCurves:
    """Score one sequence as `ope_score` does, at all thresholds.

    Raises:
        ValueError: the lengths differ, or no frame can be scored.
    """
    pairs = [(b, t) for b, t in list(zip(boxes, truth, strict=True))[1:] if t is not None]
    if not pairs:
        raise ValueError("no frame after the first one has a true box")
    iou = np.array([box.iou(true) if box else 0.0 for box, true in pairs])
    off = np.array([box.distance(true) if box else math.inf for box, true in pairs])
    relative = np.array([_relative(box, true) for box, true in pairs])
    return OpeCurves(
        tuple(np.mean(iou[:, None] > SUCCESS_AT, axis=0).tolist()),
        tuple(np.mean(off[:, None] <= PRECISION_AT, axis=0).tolist()),
        tuple(np.mean(relative[:, None] <= NORMALISED_AT, axis=0).tolist()),
    )


def _relative(box: Box | None, true: Box) -> float:
    if box is None:
        return math.inf
    return math.hypot((box.cx - true.cx) / true.width, (box.cy - true.cy) / true.height)


def mean_curves(curves: Sequence[OpeCurves]) -> OpeCurves:
    """Average curves, each with the same weight.

    Raises:
        ValueError: there is none.
    """
    if not curves:
        raise ValueError("there is no curve to average")
    means = [
        tuple(np.mean([getattr(c, name) for c in curves], axis=0).tolist())
        for name in ("success", "precision", "normalised")
    ]
    return OpeCurves(*means)


def temporal_starts(truth: Sequence[Box | None], number: int) -> list[int]:
    """Return up to `number` frames, evenly apart, to start from: each has a box and a successor."""
    wanted = [len(truth) * index // number for index in range(number)]
    present = [k for k, box in enumerate(truth) if box and any(truth[k + 1 :])]
    later = (next((k for k in present if k >= frame), None) for frame in wanted)
    return sorted({frame for frame in later if frame is not None})


def spatial_starts(box: Box) -> list[Box]:
    """Return the twelve disturbed start boxes: eight shifts by a tenth, four scales."""
    steps = [(x, y) for x in (-0.1, 0, 0.1) for y in (-0.1, 0, 0.1) if (x, y) != (0, 0)]
    shifts = [box.moved_to(box.cx + x * box.width, box.cy + y * box.height) for x, y in steps]
    return [*shifts, *(box.scaled(factor) for factor in (0.8, 0.9, 1.1, 1.2))]
