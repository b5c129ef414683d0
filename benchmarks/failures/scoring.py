"""How well a tracker did on a clip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from failures.clip import Clip
from follower_vision.geometry.box import Box

_HIT = 0.5
_FOUND = 0.3
_PRECISE_PX = 20.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came out on one clip.

    Attributes:
        success: share of frames with IoU > 0.5.
        precision: share of frames with the centre within 20 pixels.
        lies: share of frames called TRACKING at IoU 0, or while the target was out of sight.
        doubts: share of frames with IoU > 0.5 that were not called TRACKING.
        found_s: time from each return of the target until it was tracked; infinite if never.
    """

    success: float
    precision: float
    lies: float
    doubts: float
    found_s: tuple[float, ...]


def outcome(clip: Clip, boxes: list[Box], tracking: list[bool]) -> Outcome:
    """Score one box and state a frame; the first frame, which is given, does not count."""
    overlap = np.array(
        [0.0 if b is None else a.iou(b) for a, b in zip(boxes, clip.truth, strict=True)]
    )[1:]
    there = np.array([box is not None for box in clip.truth])[1:]
    near = np.array(
        [
            b is not None and a.distance(b) <= _PRECISE_PX
            for a, b in zip(boxes, clip.truth, strict=True)
        ]
    )[1:]
    said = np.array(tracking)[1:]
    judged = np.array([number not in clip.edge for number in range(len(clip))])[1:]
    right = overlap > _HIT
    return Outcome(
        float(right[there].mean()),
        float(near[there].mean()),
        float((said & (overlap <= 0))[judged].mean()),
        float((right & ~said).mean()),
        _found_s(clip, said & (overlap > _FOUND)),
    )


def _found_s(clip: Clip, followed: npt.NDArray[np.bool_]) -> tuple[float, ...]:
    answers = []
    for number in clip.returns():
        hits = np.flatnonzero(followed[number - 1 :])
        answers.append(float(hits[0]) / clip.rate_hz if hits.size else float("inf"))
    return tuple(answers)
