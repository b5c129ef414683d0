"""Tells the target from look-alikes by how they stand to one another."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from follower_vision.box import Box
from follower_vision.motion import MotionEstimate

LEAST_SHARE = 0.5
"""A look-alike has at least this share of the target's confidence."""

_LEAST_SHARE_NEW = 0.8
_MOST_COMMON = 0.55
_MOST_SIZE_RATIO = 1.4
_HITS_TO_KNOW = 3
_HITS_TO_COUNT = 5
_HITS_KEPT = 15
_KEPT_S = 0.6
_MOST = 6
_LEAST_FIT = 0.3
_REACH_SIDES = 0.8
_STAY = 0.3
_MERGED_IOU = 0.1


class _Rival:
    """One look-alike: where it was beside the target, in pixels right and down, and when.

    Attributes:
        merged: whether it has come together with the target since it was last seen.
    """

    def __init__(self, now_s: float, away: tuple[float, float]) -> None:
        self._seen: deque[tuple[float, float, float]] = deque(maxlen=_HITS_KEPT)
        self.see(now_s, away)

    @property
    def hits(self) -> int:
        """How often it was seen lately."""
        return len(self._seen)

    def see(self, now_s: float, away: tuple[float, float]) -> None:
        """It is here, beside the target."""
        self._seen.append((now_s, *away))
        self.merged = False

    def unseen_s(self, now_s: float) -> float:
        """How long it has not been seen."""
        return now_s - self._seen[-1][0]

    def expected(self, now_s: float) -> tuple[float, float]:
        """Where it should be beside the target: the straight line through what was seen."""
        seen = np.array(self._seen)
        since = seen[:, 0] - seen[:, 0].mean()
        middle = seen[:, 1:].mean(axis=0)
        spread = float(since @ since)
        slope = since @ (seen[:, 1:] - middle) / spread if spread > 0 else np.zeros(2)
        right, down = middle + slope * (now_s - seen[:, 0].mean())
        return float(right), float(down)


class Rivals:
    """Decides, among the look-alikes in the motion tracker's window, which one is the target.

    Where two come together, nobody can tell them apart; when they part, they go on as before. All
    that counts is how they stand and move relative to one another, so that the camera's motion and
    the target's own cancel out.
    """

    def __init__(self) -> None:
        self._known: list[_Rival] = []
        self._now_s = 0.0
        self._standing: list[Box] = []

    @property
    def standing(self) -> Sequence[Box]:
        """The established look-alikes that stand beside the target in the present frame."""
        return self._standing

    @property
    def merged(self) -> bool:
        """Whether the target and a look-alike are seen as one at present."""
        return any(one.merged for one in self._known)

    def advance(self, interval_s: float) -> None:
        """Go on to the next frame."""
        self._now_s += interval_s
        self._known = [one for one in self._known if one.unseen_s(self._now_s) <= _KEPT_S]

    def settle(
        self, expected: Box, estimate: MotionEstimate, candidates: Sequence[MotionEstimate]
    ) -> MotionEstimate:
        """Return the place that is the target.

        If the tracker has gone over to a look-alike and nothing is left where the target should be,
        that is hidden: the place expected is returned, with no confidence.

        Args:
            expected: where the target should be.
            estimate: what the motion tracker takes for it.
            candidates: every place like it that the tracker saw.
        """
        places = [estimate, *_others(estimate, candidates)]
        away = self._parted(estimate)
        fits = [self._fit(place, places, away) for place in places]
        fits[0] += _STAY
        target = places[fits.index(max(fits))]
        if target is estimate and self._jumped(expected, estimate):
            target = _nearest(expected, places)
            if target is estimate:
                self._standing = [estimate.box]
                return replace(estimate, box=expected, confidence=0.0)
        if target is not estimate:
            self._known = []
        self._share_out(target, [place for place in places if place is not target])
        self._notice_merging(target.box)
        return target

    def _parted(self, target: MotionEstimate) -> list[tuple[float, float]]:
        """Where those should be that came together with the target and should be clear of it."""
        reach_px = _REACH_SIDES * min(target.box.width, target.box.height)
        away = [one.expected(self._now_s) for one in self._known if one.merged]
        return [one for one in away if _likeness(one, (0.0, 0.0), reach_px) < _LEAST_FIT]

    def _fit(
        self,
        target: MotionEstimate,
        places: Sequence[MotionEstimate],
        away: Sequence[tuple[float, float]],
    ) -> float:
        """How well the others stand as they should if this is the target, 0 to 1."""
        others = [_beside(target.box, place.box) for place in places if place is not target]
        if not others or not away:
            return 0.0
        reach_px = _REACH_SIDES * min(target.box.width, target.box.height)
        best = [max(_likeness(one, other, reach_px) for other in others) for one in away]
        return sum(best) / len(best)

    def _jumped(self, expected: Box, estimate: MotionEstimate) -> bool:
        """Whether the tracker has gone over to a look-alike's place."""
        reach_px = _REACH_SIDES * min(expected.width, expected.height)
        here = _beside(expected, estimate.box)
        if _likeness(here, (0.0, 0.0), reach_px) >= _LEAST_FIT:
            return False
        known = [one.expected(self._now_s) for one in self._known if one.hits >= _HITS_TO_KNOW]
        return any(_likeness(here, one, reach_px) >= _LEAST_FIT for one in known)

    def _share_out(self, target: MotionEstimate, places: list[MotionEstimate]) -> None:
        """Give each look-alike its place; what is left and very likely is new."""
        reach_px = _REACH_SIDES * min(target.box.width, target.box.height)
        self._standing = []
        for one in sorted(self._known, key=lambda rival: -rival.hits):
            expected = one.expected(self._now_s)
            beside = [_beside(target.box, place.box) for place in places]
            fits = [_likeness(expected, other, reach_px) for other in beside]
            if fits and max(fits) >= _LEAST_FIT:
                best = fits.index(max(fits))
                one.see(self._now_s, beside[best])
                place = places.pop(best)
                if one.hits >= _HITS_TO_KNOW:
                    self._standing.append(place.box)
        least = _LEAST_SHARE_NEW * target.confidence
        self._known += [
            _Rival(self._now_s, _beside(target.box, place.box))
            for place in places
            if place.confidence >= least
        ]
        self._known = self._known[:_MOST]

    def _notice_merging(self, box: Box) -> None:
        for one in self._known:
            if one.hits >= _HITS_TO_COUNT and one.unseen_s(self._now_s) > 0:
                right, down = one.expected(self._now_s)
                place = box.moved_to(box.cx + right, box.cy + down)
                one.merged = one.merged or place.iou(box) > _MERGED_IOU


def _others(estimate: MotionEstimate, candidates: Sequence[MotionEstimate]) -> list[MotionEstimate]:
    """The candidates that are something else, no part of it, and of about the same size."""
    return [
        one
        for one in candidates
        if one.confidence >= LEAST_SHARE * estimate.confidence
        and _common(one.box, estimate.box) < _MOST_COMMON
        and 1 / _MOST_SIZE_RATIO < one.box.scale / estimate.box.scale < _MOST_SIZE_RATIO
    ]


def _nearest(expected: Box, places: Sequence[MotionEstimate]) -> MotionEstimate:
    return min(places, key=lambda place: place.box.distance(expected))


def _common(one: Box, other: Box) -> float:
    """How much of the smaller box lies in the other."""
    return one.intersection(other) / min(one.area, other.area)


def _beside(box: Box, other: Box) -> tuple[float, float]:
    return other.cx - box.cx, other.cy - box.cy


def _likeness(one: tuple[float, float], other: tuple[float, float], reach_px: float) -> float:
    return math.exp(-((math.dist(one, other) / reach_px) ** 2))
