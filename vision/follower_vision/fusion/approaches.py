"""How look-alikes came up to the target: two that pass one another go on as they came."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from follower_vision.box import Box

_KEPT_S = 3.0
_LEAST_SIGHTS, _LEAST_S, _FITTED_S = 3, 0.3, 1.2
_SAME_SIZES, _SAME_SIZES_S = 0.5, 1.0
_HIDDEN_S = 0.3
_REACH_SIZES, _REACH_SIZES_S = 0.5, 0.5
_NEAR_SIZES = 1.5
_FARTHEST_SIZES = 6.0
_COVERED = 0.2

_Way = tuple[float, float]


class _Approach:
    """The way of one look-alike relative to the target, in target sizes right and down of it."""

    def __init__(self, now_s: float, away: _Way) -> None:
        self._seen: deque[tuple[float, float, float]] = deque([(now_s, *away)])

    @property
    def last_s(self) -> float:
        """When the two were seen apart last."""
        return self._seen[-1][0]

    @property
    def is_known(self) -> bool:
        """Whether it was seen often enough to foretell its way."""
        return len(self._seen) >= _LEAST_SIGHTS and self.last_s - self._seen[0][0] >= _LEAST_S

    def see(self, now_s: float, away: _Way) -> None:
        """It is here, and clear of the target."""
        self._seen.append((now_s, *away))
        while now_s - self._seen[0][0] > _FITTED_S:
            self._seen.popleft()

    def expected(self, now_s: float) -> _Way:
        """Return where it should be, on the straight line through what was seen."""
        if not self.is_known:
            return self._seen[-1][1:]
        seen = np.array(self._seen)
        since = seen[:, 0] - seen[:, 0].mean()
        middle = seen[:, 1:].mean(axis=0)
        slope = since @ (seen[:, 1:] - middle) / float(since @ since)
        right, down = (middle + slope * (now_s - seen[:, 0].mean())).tolist()
        return right, down

    def passes(self, now_s: float) -> bool:
        """Whether that line has come near the target since the two were seen apart last."""
        (x0, y0), (x1, y1) = self.expected(self.last_s), self.expected(now_s)
        right, down = x1 - x0, y1 - y0
        length2 = right * right + down * down
        if length2 == 0:
            return False
        share = min(1.0, max(0.0, -(x0 * right + y0 * down) / length2))
        return math.hypot(x0 + share * right, y0 + share * down) < _NEAR_SIZES


class Approaches:
    """The look-alikes about the target, as long as they are clear of it, and three seconds more.

    Where two come together nobody can tell them apart. What counts is how one moved relative to the
    other, so that the camera's motion cancels out, and the target's own.
    """

    def __init__(self) -> None:
        self._known: list[_Approach] = []

    def see(self, now_s: float, target: Box, others: Sequence[Box]) -> None:
        """Take where the target is, and who is beside it."""
        left = [_away(target, box) for box in others if _is_clear(box, target)]
        for one in self._known:
            expected = one.expected(now_s)
            reach = _SAME_SIZES + _SAME_SIZES_S * (now_s - one.last_s)
            nearest = min(left, key=lambda away: math.dist(away, expected), default=None)
            if nearest is not None and math.dist(nearest, expected) < reach:
                one.see(now_s, nearest)
                left.remove(nearest)
        self._known += [_Approach(now_s, away) for away in left]
        self._known = [one for one in self._known if now_s - one.last_s <= _KEPT_S]

    def exchanged(self, now_s: float, followed: Box, other: Box) -> tuple[float, float]:
        """Return how much better two boxes fit somebody's way if the other one is the target.

        Args:
            now_s: when they are seen.
            followed: what is taken for the target.
            other: what parted from it.

        Returns:
            From -1 to 1, 0 if nobody is known to have come up to the target; and since when the two
            were not seen apart, infinite in that case.
        """
        best, since_s = 0.0, math.inf
        here = _away(followed, other)
        for one in self._known:
            age_s = now_s - one.last_s
            if one.is_known and age_s >= _HIDDEN_S and one.passes(now_s):
                right, down = one.expected(now_s)
                reach = _REACH_SIZES + _REACH_SIZES_S * age_s
                stayed = _fit(math.dist(here, (right, down)), reach)
                gain = _fit(math.dist(here, (-right, -down)), reach) - stayed
                if abs(gain) > abs(best):
                    best, since_s = gain, one.last_s
        return best, since_s


def _away(target: Box, other: Box) -> _Way:
    return (other.cx - target.cx) / target.scale, (other.cy - target.cy) / target.scale


def _is_clear(box: Box, target: Box) -> bool:
    """Whether neither hides much of the other, and they are about one another."""
    covered = box.intersection(target) / min(box.area, target.area)
    return covered < _COVERED and math.hypot(*_away(target, box)) < _FARTHEST_SIZES


def _fit(distance: float, reach: float) -> float:
    return math.exp(-((distance / reach) ** 2))
