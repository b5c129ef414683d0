"""The measures of one-pass evaluation: success, precision and area under the success curve.

After Wu, Lim and Yang, "Object Tracking Benchmark" (PAMI 2015): the tracker starts from the first
frame's true box and is never helped again. The first frame is not scored, nor are frames in which
the target is absent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from follower_vision.box import Box

SUCCESS_IOU = 0.5
PRECISION_PX = 20.0
_THRESHOLDS = np.linspace(0, 1, 21)


@dataclass(frozen=True, slots=True)
class OpeScore:
    """How well boxes agree with the truth over one sequence.

    Attributes:
        success: share of scored frames whose intersection over union exceeds 0.5.
        precision: share of scored frames whose centre is within 20 px of the true one.
        auc: mean, over the thresholds 0, 0.05 to 1, of the share of frames that exceed them.
        frames: number of scored frames.
    """

    success: float
    precision: float
    auc: float
    frames: int


def ope_score(boxes: Sequence[Box | None], truth: Sequence[Box | None]) -> OpeScore:
    """Score one sequence.

    Args:
        boxes: the tracker's, one a frame, the initial one first; None counts as a miss.
        truth: one a frame; None where the target is absent.

    Raises:
        ValueError: the lengths differ, or no frame can be scored.
    """
    if len(boxes) != len(truth):
        raise ValueError(f"{len(boxes)} boxes for {len(truth)} frames of truth")
    pairs = [
        (box, true) for box, true in zip(boxes[1:], truth[1:], strict=True) if true is not None
    ]
    if not pairs:
        raise ValueError("no frame after the first one has a true box")
    iou = np.array([box.iou(true) if box else 0.0 for box, true in pairs])
    distance = np.array([box.distance(true) if box else math.inf for box, true in pairs])
    return OpeScore(
        success=float(np.mean(iou > SUCCESS_IOU)),
        precision=float(np.mean(distance <= PRECISION_PX)),
        auc=float(np.mean(iou[:, None] > _THRESHOLDS)),
        frames=len(pairs),
    )


def mean_score(scores: Sequence[OpeScore]) -> OpeScore:
    """Average over sequences, each with the same weight; the frames are summed.

    Raises:
        ValueError: there is none.
    """
    if not scores:
        raise ValueError("there is no score to average")
    return OpeScore(
        success=float(np.mean([score.success for score in scores])),
        precision=float(np.mean([score.precision for score in scores])),
        auc=float(np.mean([score.auc for score in scores])),
        frames=sum(score.frames for score in scores),
    )
