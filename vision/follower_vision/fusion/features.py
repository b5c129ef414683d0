"""What speaks for and against each candidate, as numbers without dimension."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from follower_vision.detection.detection import Detection
from follower_vision.fusion.box_filter import axes_of
from follower_vision.fusion.candidates import (
    DETECTION,
    MEAN,
    PEAK,
    PREDICTION,
    SECOND,
    Candidate,
    corners_of,
)
from follower_vision.fusion.descriptor import Descriptors
from follower_vision.fusion.target import FORMERLY_S, Target, log_sides
from follower_vision.geometry.box import Box, pairwise_iou
from follower_vision.trackers.motion_tracker import ResponseMap

Floats = npt.NDArray[np.floating]
Column = Floats | float
"""One value a candidate, (N,), or one for all."""

FEATURES = (
    "is_first_peak",
    "is_other_peak",
    "is_detection",
    "is_mean",
    "is_prediction",
    "support",
    "margin",
    "best_support",
    "distance_sigma",
    "distance_sizes",
    "grown",
    "size_change",
    "shape_change",
    "grown_from_usual",
    "change_from_usual",
    "change_from_first",
    "spread",
    "speed",
    "looked",
    "detected_iou",
    "detected_score",
    "detected_class",
    "detections_elsewhere",
    "detector_hits",
    "detector_silence",
    "correlation_first",
    "colours_first",
    "features_first",
    "correlation_recent",
    "colours_recent",
    "features_recent",
    "correlation_lead",
    "colours_lead",
    "features_lead",
    "distractor_iou",
    "distractor_age",
    "distractor_probability",
    "distractor_likeness",
    "prediction_distractor",
    "foreseen",
    "foreseen_lately",
    "foreseen_before",
    "foreseen_lead",
    "unseen",
    "last_probability",
    "mean_probability",
    "visible",
    "scale",
    "is_second",
    "second_iou",
    "second_score",
    "second_peak_iou",
    "deviation",
    "deviation_before",
    "deviation_of_distractor",
)
"""Names of the features, in the order of the columns."""


@dataclass(frozen=True, slots=True)
class Situation:
    """What the features are measured against.

    Attributes:
        target: predicted to the frame.
        response: the motion tracker's.
        looked: whether the detector has answered for this frame.
        detections: its answer.
        width: of the image, in pixels.
        height: of the image, in pixels.
    """

    target: Target
    response: ResponseMap
    looked: bool
    detections: list[Detection]
    width: int
    height: int


def measure(candidates: list[Candidate], seen: Descriptors, at: Situation) -> Floats:
    """Return the features of N candidates, (N, len(FEATURES)).

    Args:
        candidates: at least one; the last one is the prediction.
        seen: what they show.
        at: the situation.
    """
    corners = corners_of([one.box for one in candidates])
    overlap = pairwise_iou(corners, corners)
    likeness = at.target.memory.likeness(seen)
    distractors = at.target.distractors
    *distracting, deviating = distractors.beside(corners)
    columns = [
        *_sources(candidates),
        *_support(corners, at.response),
        *_placing(candidates, at.target),
        *_detected(corners, at),
        *likeness.T,
        *_leads(likeness, overlap),
        *distracting,
        distractors.likeness(seen.features),
        distracting[0][-1],
        *_foreseen(corners, overlap, at.target),
        *_history(candidates, at),
        *_seconded(candidates, corners, at.response),
        *_deviating(candidates, at.target),
        deviating,
    ]
    table = np.empty((len(candidates), len(FEATURES)))
    for place, column in enumerate(columns):
        table[:, place] = column
    return table


def _sources(candidates: list[Candidate]) -> list[Column]:
    def where(source: str) -> Floats:
        return np.array([one.source == source for one in candidates], float)

    peak, first = where(PEAK), np.array([one.rank == 0 for one in candidates], float)
    others = [where(one) for one in (DETECTION, MEAN, PREDICTION)]
    return [peak * first, peak * (1 - first), *others]


def _support(corners: Floats, response: ResponseMap) -> list[Column]:
    """What the motion tracker says of the place, and how much better that is than elsewhere."""
    table = pairwise_iou(corners, response.corners)
    weighed = np.minimum(response.scores, 1.0) * response.penalty
    support = (table * weighed).max(axis=1)
    elsewhere = (weighed * (table < 0.2)).max(axis=1)
    return [support, support - elsewhere, np.max(weighed)]


def _placing(candidates: list[Candidate], target: Target) -> list[Column]:
    """How the box lies to the prediction, and its size to what is usual."""
    boxes = np.array([axes_of(one.box) for one in candidates])
    expected = target.filter.box
    away = boxes - axes_of(expected)
    distance = np.hypot(away[:, 0], away[:, 1])
    sigma = target.filter.deviations
    grown = 0.5 * (away[:, 2] + away[:, 3])
    from_usual = boxes[:, 2:] - target.usual_size
    from_first = boxes[:, 2:] - log_sides(target.first_box)
    return [
        np.log1p(np.hypot(away[:, 0] / sigma[0], away[:, 1] / sigma[1])),
        np.log1p(distance / expected.scale),
        grown,
        np.abs(grown),
        np.abs(away[:, 2] - away[:, 3]),
        from_usual.mean(axis=1),
        np.abs(from_usual).max(axis=1),
        np.abs(from_first).max(axis=1),
        math.log1p(target.filter.spread * 10),
        math.log1p(target.filter.speed),
    ]


def _detected(corners: Floats, at: Situation) -> list[Column]:
    """What the detector says of the place."""
    count, memory = len(corners), at.target.detector
    nothing = np.zeros(count)
    seen, score, kind, elsewhere = nothing, nothing, nothing, nothing
    if at.detections:
        boxes = corners_of([memory.corrected(one) for one in at.detections])
        scores = np.array([one.score for one in at.detections])
        shares = np.array([memory.class_share(one) for one in at.detections])
        table = pairwise_iou(corners, boxes)
        worth = table * (0.2 + scores) * (0.2 + shares)
        best = worth.argmax(axis=1)
        rows = np.arange(count)
        seen = table[rows, best]
        score, kind = scores[best] * (seen > 0.1), shares[best] * (seen > 0.1)
        elsewhere = ((table < 0.2) * scores * shares).max(axis=1)
    return [
        at.looked,
        seen,
        score,
        kind,
        elsewhere,
        memory.hits,
        math.log1p(min(memory.silence, 20)),
    ]


def _leads(likeness: Floats, overlap: Floats) -> list[Column]:
    """How much more alike a candidate is than the best one beside it, by the recent views."""
    beside = overlap < 0.3
    leads: list[Column] = []
    for column in (3, 4, 5):
        values = likeness[:, column]
        others = np.where(beside, values[None, :], -1.0).max(axis=1)
        leads.append(np.where(beside.any(axis=1), values - others, 0.0))
    return leads


def _foreseen(corners: Floats, overlap: Floats, target: Target) -> list[Column]:
    """How the place fits what control foretells, by what it believes now, lately and before.

    Where a look-alike covered the target and is followed since, only what was believed before that
    still foretells the target. Zero is a place at the edge of what is likely, or nothing foretold.
    """
    known, now_s = target.foreseen, target.captured_s
    nothing = np.zeros(len(corners))
    if known is None:
        return [nothing, nothing, nothing, nothing]
    middles = (corners[:, :2] + corners[:, 2:]) / 2

    def misfit(cx: float, cy: float, likely: Box) -> Floats:
        away = np.hypot(middles[:, 0] - cx, middles[:, 1] - cy)
        return np.asarray(np.log1p(2 * away / max(likely.width, likely.height)) - math.log(2))

    by_age: tuple[list[Floats], list[Floats]] = ([], [])
    for one in known.earlier:
        by_age[now_s - one.since_s > FORMERLY_S].append(misfit(one.cx, one.cy, one.likely))
    lately, before = (np.mean(fits, axis=0) if fits else nothing for fits in by_age)
    every = [fit for fits in by_age for fit in fits]
    lead = nothing
    if every:
        mean = np.mean(every, axis=0)
        beside = overlap < 0.3
        others = np.where(beside, mean[None, :], np.inf).min(axis=1)
        lead = np.where(beside.any(axis=1), np.clip(others - mean, -2.0, 2.0), 0.0)
    return [misfit(known.cx, known.cy, known.likely), lately, before, lead]


def _deviating(candidates: list[Candidate], target: Target) -> list[Column]:
    """How far it is from where control foretells it now, and foretold it before."""
    if target.foreseen is None:
        return [0.0, 0.0]
    table = np.array([target.deviations(one.box) for one in candidates])
    return [*np.log1p(np.minimum(table, 20.0)).T]


def _seconded(candidates: list[Candidate], corners: Floats, response: ResponseMap) -> list[Column]:
    """What the second motion tracker says of the place, and whether the first one agrees."""
    second = response.second
    if second is None:
        return [0.0] * 4
    overlap = pairwise_iou(corners, corners_of([second.box]))[:, 0]
    own = np.array([one.source == SECOND for one in candidates], float)
    return [own, overlap, second.confidence, overlap[0]]


def _history(candidates: list[Candidate], at: Situation) -> list[Column]:
    """How the track went until now, and the candidate's place in the image."""
    target = at.target
    visible = np.array([one.box.visible_share(at.width, at.height) for one in candidates])
    unseen_s = target.captured_s - target.seen_s
    return [
        math.log1p(10 * min(unseen_s, 10.0)),
        target.probability,
        target.mean_probability,
        visible,
        0.2 * math.log(target.filter.box.scale),
    ]
