"""Which detections can be the target: its class, and how its box differs from the detector's."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np

from follower_vision.box import Box
from follower_vision.detection.detection import Detection
from follower_vision.fusion.history import Moment
from follower_vision.fusion.settings import FusionSettings
from follower_vision.fusion.validation import Sight

_LEAST_OVERLAP = 0.35
_LEAST_MEAN_VOTE = 0.3
_RIVAL_SHARE = 0.5
_LOOKS_TO_LOCK = 3
_HITS_KEPT = 9
_FIRST_LOOK_WEIGHT = 3.0
_SAME_OBJECT_IOU = 0.6
_PRIOR_WEIGHT = 1.0


class ClassLock:
    """Learns the target's class by overlap voting.

    Each look gives every class the largest overlap of its detections with the target. A class is
    the target's if it is the best, or has at least half the best one's votes (car and truck).
    """

    def __init__(self) -> None:
        self._votes: dict[int, float] = defaultdict(float)
        self._looks = 0.0

    @property
    def looks(self) -> float:
        """How many looks were voted on."""
        return self._looks

    def vote(self, detections: Iterable[Detection], target: Box, weight: float = 1.0) -> None:
        """Count one look."""
        best: dict[int, float] = defaultdict(float)
        for one in detections:
            overlap = one.box.iou(target)
            if overlap >= _LEAST_OVERLAP:
                best[one.class_id] = max(best[one.class_id], overlap)
        for number, overlap in best.items():
            self._votes[number] += weight * overlap
        self._looks += weight

    @property
    def classes(self) -> frozenset[int]:
        """The numbers of the target's classes; empty while none is known."""
        if self._looks < _LOOKS_TO_LOCK or not self._votes:
            return frozenset()
        best = max(self._votes.values())
        if best < _LEAST_MEAN_VOTE * self._looks:
            return frozenset()
        return frozenset(
            number for number, votes in self._votes.items() if votes >= _RIVAL_SHARE * best
        )


class BoxRatio:
    """Learns the target's box from the detector's, for each class: a rider from the person.

    The mean over the first hits of the offset (in detected sizes) and the log ratio of the sides.
    One imagined hit without any difference keeps a single odd one from counting in full.
    """

    def __init__(self) -> None:
        self._hits: dict[int, list[tuple[float, tuple[float, float, float, float]]]] = {}

    def learn(self, detection: Detection, target: Box, weight: float = 1.0) -> None:
        """Take a detection that is known to be the target; the first nine of a class count."""
        hits = self._hits.setdefault(detection.class_id, [])
        if len(hits) < _HITS_KEPT:
            hits.append((weight, _difference(detection.box, target)))

    def target_box(self, detection: Detection) -> Box:
        """Return the target's box, if this detection is the target."""
        hits = self._hits.get(detection.class_id, [])
        weights = np.array([weight for weight, _ in hits] + [_PRIOR_WEIGHT])
        known = np.array([values for _, values in hits] + [(0.0, 0.0, 0.0, 0.0)])
        right, down, wider, taller = (float(v) for v in weights @ known / weights.sum())
        box = detection.box
        return Box(
            box.cx + right * box.width,
            box.cy + down * box.height,
            box.width * math.exp(wider),
            box.height * math.exp(taller),
        )


def _difference(seen: Box, target: Box) -> tuple[float, float, float, float]:
    return (
        (target.cx - seen.cx) / seen.width,
        (target.cy - seen.cy) / seen.height,
        math.log(target.width / seen.width),
        math.log(target.height / seen.height),
    )


class Identity:
    """What kind of thing the target is, learnt in the first looks."""

    def __init__(self, settings: FusionSettings) -> None:
        self._settings = settings
        self._lock = ClassLock()
        self._ratio = BoxRatio()

    @property
    def familiar(self) -> bool:
        """Whether the detector knows the target."""
        return bool(self._lock.classes)

    @property
    def strange(self) -> bool:
        """Whether the detector has looked often enough to say that it will never know it."""
        return self._lock.looks >= self._settings.vote_looks and not self.familiar

    def meet(self, detections: Sequence[Detection], moment: Moment) -> None:
        """Learn from a look at the target, while it is new."""
        if self._lock.looks >= self._settings.vote_looks:
            return
        first = moment.index == 0
        weight = _FIRST_LOOK_WEIGHT if first else 1.0
        self._lock.vote(detections, moment.box, weight)
        fits = [
            one
            for one in detections
            if not one.cut
            and one.class_id in self._lock.classes
            and one.box.iou(moment.box) >= _LEAST_OVERLAP
        ]
        if fits and self._settings.learn_box_ratio:
            best = max(fits, key=lambda one: one.box.iou(moment.box))
            self._ratio.learn(best, moment.box, weight)

    def sight(self, detections: Sequence[Detection], moment: Moment) -> Sight:
        """Return the detections that could be the target, one an object."""
        chosen: list[Detection] = []
        boxes: list[Box] = []
        for one in detections:
            if not one.cut and self._possible(one):
                box = self._ratio.target_box(one)
                if all(box.iou(other) < _SAME_OBJECT_IOU for other in boxes):
                    chosen.append(one)
                    boxes.append(box)
        return Sight(moment, boxes, chosen)

    def _possible(self, one: Detection) -> bool:
        return not self._settings.class_lock or one.class_id in self._lock.classes
