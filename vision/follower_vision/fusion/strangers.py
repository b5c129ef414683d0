"""Remembers who stood beside the target, so that nobody of them is taken for it later."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from follower_vision.box import Box
from follower_vision.fusion.history import History, Moment

_KEPT_S = 2.0
_MOST = 8
_REACH_SIZES = 0.5
_REACH_SIZES_S = 0.5
_LEAST_FIT = 0.3


@dataclass(slots=True)
class _Stranger:
    """A look-alike: its box at `moment`, when it was last seen."""

    box: Box
    moment: Moment

    def fit(self, box: Box, history: History) -> float:
        """How well a box in the present frame stands where this one should be, 0 to 1."""
        place = history.warp(self.moment, history.now).box(self.box)
        return nearness(place, box, history.now.captured_s - self.moment.captured_s)


class Strangers:
    """The motion tracker's look-alikes of the last two seconds, where they stand on the ground.

    They were seen while the target was surely seen as well, so they are somebody else. While the
    target is out of sight, a place that is one of theirs is refused, and they are followed there.
    """

    def __init__(self) -> None:
        self._known: list[_Stranger] = []

    def meet(self, boxes: Iterable[Box], history: History) -> None:
        """Take what stands beside the target in the present frame."""
        for box in boxes:
            self._put(box, history)
        since_s = history.now.captured_s - _KEPT_S
        self._known = [one for one in self._known if one.moment.captured_s >= since_s][-_MOST:]

    def refuse(self, box: Box, expected: Box, unseen_s: float, history: History) -> bool:
        """Tell whether a place is rather a stranger's than the target's; then it is there still.

        Args:
            box: the place in question.
            expected: where the target should be.
            unseen_s: how long it has not been seen.
            history: ends with the present frame.
        """
        fits = [one.fit(box, history) for one in self._known]
        best = max(fits, default=0.0)
        if best < _LEAST_FIT or best <= nearness(expected, box, unseen_s):
            return False
        self._put(box, history)
        return True

    def _put(self, box: Box, history: History) -> None:
        fits = [one.fit(box, history) for one in self._known]
        best = max(fits, default=0.0)
        if best >= _LEAST_FIT:
            self._known.pop(fits.index(best))
        self._known.append(_Stranger(box, history.now))


def nearness(place: Box, box: Box, age_s: float) -> float:
    """Return how near a box is to a place that is this old, 0 to 1."""
    reach_px = place.scale * (_REACH_SIZES + _REACH_SIZES_S * age_s)
    return math.exp(-((place.distance(box) / reach_px) ** 2))
