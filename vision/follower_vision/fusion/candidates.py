"""The candidates among which Fusion chooses: where the target might be in a frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from follower_vision.detection.detection import Detection
from follower_vision.fusion.box_filter import axes_of
from follower_vision.geometry.box import Box, keep_best, pairwise_iou
from follower_vision.trackers.motion_tracker import ResponseMap

PEAK, DETECTION, MEAN, PREDICTION = "peak", "detection", "mean", "prediction"
SECOND = "second"
SOURCES = (PEAK, DETECTION, MEAN, PREDICTION, SECOND)
"""Best places of the response map; detections; the mean of two of them; the predicted box; the
second motion tracker's place."""

_PENALTY_POWER = 2.2
"""NanoTrack's penalty on changes of size, 0.138, becomes 0.30, which loses fewer targets."""
_PEAKS = 4
_PEAK_OVERLAP = 0.5
_LEAST_PEAK = 0.05
_LEAST_SIDE_PX = 2.0
_SAME_IOU = 0.4
_MOST_DETECTIONS = 5
_ANY_CLASS = 0.2
"""A detection of a class that the target was never seen as still counts so much."""
_HIT_IOU = 0.3
_HIT_RATE = 0.1
_REMEMBERED_RATIOS = 20.0
_AGREED_IOU = 0.3
_AGREED_POWER = 4
"""Between a mean of all that agree (0) and the chosen box alone; 2 to 6 do the same."""
_LEAST_MERIT = 1e-9
"""Where nothing is believed at all, there is still a mean."""

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True, slots=True)
class Candidate:
    """A place where the target might be.

    Attributes:
        box: in pixels.
        source: one of `SOURCES`.
        rank: 0 for the best of its source.
    """

    box: Box
    source: str
    rank: int = 0


def propose(
    response: ResponseMap, detections: list[Detection], memory: DetectorMemory, expected: Box
) -> list[Candidate]:
    """Return a frame's candidates, the best of each source first, the prediction last.

    Args:
        response: the motion tracker's.
        detections: in the same frame.
        memory: how the detector's boxes differ from the target's.
        expected: the predicted box, in pixels.
    """
    found = _peaks(response, expected)
    likeliest = sorted(
        detections, key=lambda one: -one.score * (_ANY_CLASS + memory.class_share(one))
    )
    detected = [
        Candidate(memory.corrected(one), DETECTION, rank)
        for rank, one in enumerate(likeliest[:_MOST_DETECTIONS])
    ]
    mean = _mean(found, detected)
    second = [] if response.second is None else [Candidate(response.second.box, SECOND)]
    mean += _mean(found, second)
    return [*found, *second, *mean, *detected, Candidate(expected, PREDICTION)]


def _peaks(response: ResponseMap, expected: Box) -> list[Candidate]:
    """The best places of a search, the best first."""
    scores = response.scores * response.penalty**_PENALTY_POWER
    likely = np.flatnonzero(scores >= min(_LEAST_PEAK, float(scores.max())))
    kept = keep_best(response.corners[likely], scores[likely], _PEAK_OVERLAP, _PEAKS)
    candidates = []
    for rank, index in enumerate(kept):
        left, top, right, bottom = (float(edge) for edge in response.corners[likely[index]])
        width, height = max(right - left, _LEAST_SIDE_PX), max(bottom - top, _LEAST_SIDE_PX)
        box = Box((left + right) / 2, (top + bottom) / 2, width, height)
        candidates.append(Candidate(box, PEAK, rank))
    return candidates or [Candidate(expected, PEAK)]


def _mean(found: list[Candidate], detected: list[Candidate]) -> list[Candidate]:
    """The mean of the first peak and the detection that overlaps it most, if one does."""
    first = found[0].box
    nearest = max(detected, key=lambda one: first.iou(one.box), default=None)
    if nearest is None or first.iou(nearest.box) < _SAME_IOU:
        return []
    return [Candidate(_mean_box([first, nearest.box], np.ones(2)), MEAN)]


def agreed_box(boxes: list[Box], merit: Floats, chosen: int) -> Box:
    """Return the mean of the boxes that lie where the chosen one does, the likelier ones first.

    Each has the size of its own source; the mean errs less than the one that was chosen. Known as
    box voting: Gidaris and Komodakis, "Object Detection via a Multi-Region and Semantic
    Segmentation-Aware CNN Model" (ICCV 2015).

    Args:
        boxes: N, in pixels.
        merit: (N,) how good each is, from 0 on.
        chosen: index of the one that was taken.
    """
    corners = corners_of(boxes)
    agree = pairwise_iou(corners[chosen : chosen + 1], corners)[0] >= _AGREED_IOU
    weights = agree * (merit + _LEAST_MERIT) ** _AGREED_POWER
    return _mean_box(boxes, weights)


def _mean_box(boxes: list[Box], weights: Floats) -> Box:
    axes = np.array([axes_of(box) for box in boxes])
    cx, cy, wide, tall = (weights @ axes / weights.sum()).tolist()
    return Box(cx, cy, math.exp(wide), math.exp(tall))


def corners_of(boxes: list[Box]) -> Floats:
    """Return left, top, right, bottom of N boxes, (N, 4), in pixels."""
    return np.array([[box.left, box.top, box.right, box.bottom] for box in boxes]).reshape(-1, 4)


class DetectorMemory:
    """What the detector sees of the target: its class, how its box differs, and how often.

    Attributes:
        hits: share of the looks at the target's place in which it was detected, 0 to 1.
        silence: so many looks in a row did not detect it.
    """

    def __init__(self) -> None:
        self._votes: dict[int, float] = {}
        self._ratio = np.zeros(4)
        self._weight = 0.0
        self.hits = 0.5
        self.silence = 0

    def corrected(self, detection: Detection) -> Box:
        """Return the target's box as it follows from the detector's, in pixels."""
        box = detection.box
        right, down, wider, taller = self._ratio.tolist()
        return Box(
            box.cx + right * box.width,
            box.cy + down * box.height,
            box.width * math.exp(wider),
            box.height * math.exp(taller),
        )

    def class_share(self, detection: Detection) -> float:
        """Return the share of the votes for a detection's class, 0 to 1."""
        total = sum(self._votes.values())
        return self._votes.get(detection.class_id, 0.0) / total if total else 0.0

    def learn(self, detections: list[Detection], target: Box, probability: float) -> None:
        """Compare a look at the target's place with the target's box, known so probably."""
        best = _overlapping(target, [(self.corrected(one), one) for one in detections])
        if best is None:
            best = _overlapping(target, [(one.box, one) for one in detections])
        self.hits += _HIT_RATE * probability * ((best is not None) - self.hits)
        self.silence = 0 if best is not None else self.silence + 1
        if best is None:
            return
        for one in detections:
            if one.box.iou(best.box) > 0.5:
                vote = self._votes.get(one.class_id, 0.0) + probability * one.score
                self._votes[one.class_id] = vote
        if not best.cut:
            self._learn_ratio(best.box, target, probability)

    def _learn_ratio(self, seen: Box, target: Box, probability: float) -> None:
        ratio = np.array(
            [
                (target.cx - seen.cx) / seen.width,
                (target.cy - seen.cy) / seen.height,
                math.log(target.width / seen.width),
                math.log(target.height / seen.height),
            ]
        )
        self._weight = min(self._weight + probability, _REMEMBERED_RATIOS)
        share = probability / self._weight
        self._ratio = self._ratio + share * (np.clip(ratio, -1.0, 1.0) - self._ratio)


def _overlapping(target: Box, boxes: list[tuple[Box, Detection]]) -> Detection | None:
    """The detection whose box overlaps the target most, None if none does enough."""
    best = max(boxes, key=lambda pair: pair[0].iou(target), default=None)
    return best[1] if best is not None and best[0].iou(target) >= _HIT_IOU else None
