"""Tells the target from a look-alike that came close, when the two part."""

from __future__ import annotations

import math
from collections.abc import Sequence

from follower_vision.box import Box
from follower_vision.fusion.approaches import Approaches
from follower_vision.fusion.belief import SAME_IOU, Belief
from follower_vision.fusion.history import Moment
from follower_vision.fusion.neighbours import Neighbours
from follower_vision.prospect import Forecast

_LATEST_S, _LATELY_S = 0.3, 1.0
_SUSPECTED_S = 0.5
_SAME_SIZES, _SAME_SIZES_S = 0.5, 1.0
_APART_SIZES = 0.5
_REACH_SIZES = 0.25
_BETTER, _PASSED, _LEAST_BELIEFS = 0.13, 0.3, 3
_BEHIND, _SURELY_BEHIND, _SEEN_IOU = 0.15, 0.5, 0.3
_SEEN_S, _PART_SIZES = 0.5, 1.5
_FORETOLD_S, _UNFIT = (0.5, 1.5), 0.6


class Parting:
    """Finds out that a look-alike is followed that came before the target.

    It covers the target and takes the motion tracker along, and whoever steers by the track. But
    what was believed before they met foretells where the target is when there are two again; and
    the look-alike goes on past the target as it came.
    """

    def __init__(self) -> None:
        self._approaches = Approaches()
        self._suspect: tuple[Moment, Box] | None = None
        self._answer: tuple[Moment, Box] | None = None

    def suspect(self, belief: Belief) -> Box | None:
        """Return where it is that one more sight would show to be the target, if there is any."""
        if self._suspect is None:
            return None
        moment, box = self._suspect
        if belief.now.captured_s - moment.captured_s >= _SUSPECTED_S:
            return None
        return belief.history.warp(moment, belief.now).box(box)

    def foretold(self, belief: Belief) -> Box | None:
        """Return where the target was foretold to be, if what is followed fits that badly.

        A target that manoeuvres fits it badly as well: so that is a place to look at, no more.
        """
        now_s, worst, place = belief.now.captured_s, _UNFIT, None
        for one in belief.earlier:
            then = belief.history.since(one.since_s)
            if then is not None and _FORETOLD_S[0] <= now_s - one.since_s <= _FORETOLD_S[1]:
                fit = _fit(one, belief, belief.box)
                if fit < worst:
                    worst, place = fit, then.box.scaled(one.nearer).moved_to(one.cx, one.cy)
        return place

    def parted(
        self,
        belief: Belief,
        moment: Moment,
        boxes: Sequence[Box],
        followed: Box,
        neighbours: Neighbours,
    ) -> tuple[Box, float] | None:
        """Return which box is the target, if that is another than the one followed.

        Two sights have to say so, one soon after the other. Beside the box is returned up to when
        what was believed was surely of the target.

        Args:
            belief: of the target.
            moment: the frame.
            boxes: what the detector sees there of the target's kind.
            followed: which of them is followed, or where.
            neighbours: who was beside what is followed, and when.
        """
        other = self._other(belief, moment, boxes, followed, neighbours)
        if other is None:
            rest = [box for box in boxes if box is not followed]
            self._approaches.see(moment.captured_s, followed, rest)
            return None
        box, since_s = other
        suspect, self._suspect = self._suspect, (moment, box)
        if suspect is None or not _goes_on(belief, *suspect, moment, box):
            return None
        self._answer = (moment, box)
        return box, since_s

    def _other(
        self,
        belief: Belief,
        moment: Moment,
        boxes: Sequence[Box],
        followed: Box,
        neighbours: Neighbours,
    ) -> tuple[Box, float] | None:
        """Return the box that fits what was foretold before it parted from the one followed."""
        best, best_gain = None, _BETTER
        known = neighbours.places(belief.history, moment, _SEEN_S)
        for box in boxes:
            apart = box.distance(followed) > _APART_SIZES * min(box.scale, followed.scale)
            if not apart or box.iou(followed) >= SAME_IOU:
                continue
            met_s = self._met_s(belief, moment, box, neighbours)
            if met_s is not None:
                gain, since_s = self._gain(belief, moment, followed, box, met_s)
                gain += _behind(box, followed, [*boxes, *known])
                if gain > best_gain:
                    best, best_gain = (box, since_s), gain
        return best

    def _met_s(
        self, belief: Belief, moment: Moment, box: Box, neighbours: Neighbours
    ) -> float | None:
        """Return up to when it was known which of a box and the one followed is the target.

        None if it still is: they were not close to one another lately, and there was no mistake.
        """
        if self._answer is not None and _goes_on(belief, *self._answer, moment, box):
            return self._answer[0].captured_s
        met_s = neighbours.met_s(box, belief.history, moment)
        return met_s if moment.captured_s - met_s <= _LATELY_S else None

    def _gain(
        self, belief: Belief, moment: Moment, followed: Box, box: Box, met_s: float
    ) -> tuple[float, float]:
        """Return how much rather a box is the target than the one followed, -1 to 1.

        And up to when what was believed was of the target, if it is the box.
        """
        passed, apart_s = self._approaches.exchanged(moment.captured_s, followed, box)
        latest_s = min(moment.captured_s - _LATEST_S, met_s, apart_s)
        warp = belief.history.warp(moment, belief.now)
        there, here = warp.box(box), warp.box(followed)
        gains = [
            (_fit(one, belief, there) - _fit(one, belief, here), one.since_s)
            for one in belief.earlier
            if one.since_s <= latest_s
        ]
        foretold, since_s = _agreed(gains)
        if abs(passed) < _PASSED:
            return foretold, since_s
        return passed if foretold > -_PASSED else -1.0, latest_s


def _agreed(gains: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Return what three or more beliefs say on average, and all that are older; at best.

    The latest may be of what covered the target already; and a single one, in the middle of a turn,
    foretells anything.

    Args:
        gains: what each says and of when it is, the latest first.

    Returns:
        The best mean, and of when the latest of these beliefs is.
    """
    cuts = (gains[first:] for first in range(len(gains) - _LEAST_BELIEFS + 1))
    means = ((sum(gain for gain, _ in cut) / len(cut), cut[0][1]) for cut in cuts)
    return max(means, default=(-1.0, -math.inf))


def _behind(box: Box, followed: Box, boxes: Sequence[Box]) -> float:
    """Return how much it speaks for a box that it is behind the one followed, 0 to 0.15.

    Of two that were one, the nearer was seen, and it is the larger one of a kind. What comes out
    from behind it was hidden by it. What is seen alone and near may be a part of what is followed.

    Args:
        box: who may have come out.
        followed: who may have hidden it.
        boxes: what is seen, and was lately.
    """
    others = [one for one in boxes if one.iou(box) < SAME_IOU]
    seen = any(one.iou(followed) >= _SEEN_IOU for one in others)
    if not seen and box.distance(followed) < _PART_SIZES * followed.scale:
        return 0.0
    smaller = math.log(followed.scale / box.scale)
    return _BEHIND * min(1.0, max(0.0, smaller / _SURELY_BEHIND))


def _fit(forecast: Forecast, belief: Belief, box: Box) -> float:
    """Return how well a box fits a forecast by place, and by size as far as that is known."""
    margin_px = _REACH_SIZES * box.scale
    right = (box.cx - forecast.cx) / (forecast.likely.width / 2 + margin_px)
    down = (box.cy - forecast.cy) / (forecast.likely.height / 2 + margin_px)
    near = math.exp(-(right**2) - down**2)
    then = belief.history.since(forecast.since_s)
    if then is None:
        return near
    change = math.log(box.scale / (forecast.nearer * then.box.scale))
    return near * math.exp(-(change**2))


def _goes_on(belief: Belief, before: Moment, was: Box, moment: Moment, box: Box) -> bool:
    """Whether a box may be what was seen a moment before."""
    age_s = moment.captured_s - before.captured_s
    away_px = belief.history.warp(before, moment).box(was).distance(box)
    return age_s < _SUSPECTED_S and away_px < box.scale * (_SAME_SIZES + _SAME_SIZES_S * age_s)
