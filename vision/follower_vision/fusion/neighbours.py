"""Follows look-alikes beside the target, so that identity is decided among all of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from follower_vision.box import Box
from follower_vision.fusion.belief import moved, towards
from follower_vision.fusion.history import History, Moment

_CLAIM = 0.3
_HITS_TO_CLAIM = 2
_MOST = 12
_KEPT_S = 2.0
_REACH_SIZES, _REACH_SIZES_S = 0.5, 0.5
_VELOCITY_SHARE, _SIZE_SHARE = 0.4, 0.4


@dataclass(slots=True)
class Neighbour:
    """One look-alike.

    Attributes:
        box: at `moment`, when it was last seen.
        moment: that frame.
        met_s: when it was so near the target last that either may be the other since.
        velocity: pixels a second over the background.
        hits: how often it was seen.
        sure: whether it is surely not the target; else that is unlikely.
    """

    box: Box
    moment: Moment
    met_s: float
    velocity: tuple[float, float] = (0.0, 0.0)
    hits: int = 1
    sure: bool = True

    def expected(self, history: History, moment: Moment) -> Box:
        """Return where it should be in another frame."""
        warp = history.warp(self.moment, moment)
        return moved(warp.box(self.box), warp.turn(*self.velocity), self.age_s(moment))

    def see(self, box: Box, history: History, moment: Moment) -> None:
        """Take a sighting."""
        expected = self.expected(history, moment)
        turned = history.warp(self.moment, moment).turn(*self.velocity)
        age_s = self.age_s(moment)
        if age_s > 0:
            share = _VELOCITY_SHARE / age_s
            self.velocity = (
                turned[0] + share * (box.cx - expected.cx),
                turned[1] + share * (box.cy - expected.cy),
            )
        # What half hides it, or the region's edge, makes a box small for a moment.
        self.box = towards(expected, box, _SIZE_SHARE).moved_to(box.cx, box.cy)
        self.moment, self.hits = moment, self.hits + 1

    def likeness(self, box: Box, history: History, moment: Moment) -> float:
        """Return how well a box in another frame fits where it should be by then, 0 to 1."""
        place = self.expected(history, moment)
        reach_sizes = _REACH_SIZES + _REACH_SIZES_S * self.age_s(moment)
        return likeness(place, box, place.scale * reach_sizes)

    def age_s(self, moment: Moment) -> float:
        """Return how long before a frame it was last seen."""
        return moment.captured_s - self.moment.captured_s


class Neighbours:
    """The look-alikes seen in the last two seconds.

    New ones are taken up only where they are surely somebody else: in looks in which the target
    itself was recognised, and where that cannot be.
    """

    def __init__(self) -> None:
        self._known: list[Neighbour] = []
        self._target: tuple[Moment, Box] | None = None

    @property
    def known(self) -> Sequence[Neighbour]:
        """All of them."""
        return self._known

    def places(self, history: History, moment: Moment, age_s: float) -> list[Box]:
        """Return where those should be in a frame who were seen no longer ago than so."""
        return [one.expected(history, moment) for one in self._known if one.age_s(moment) <= age_s]

    def meet(self, target: Box, history: History, moment: Moment) -> None:
        """Take where the target is said to be: whoever is beside it there may be it instead."""
        self._target = (moment, target)
        for one in self._known:
            if _are_beside(one.expected(history, moment), target):
                one.met_s = moment.captured_s

    def met_s(self, box: Box, history: History, moment: Moment) -> float:
        """Return when what a box shows in a frame was beside the target last; -inf if never."""
        fits = [(one.likeness(box, history, moment), one.met_s) for one in self._known]
        best, met_s = max(fits, default=(0.0, -math.inf))
        return met_s if best >= _CLAIM else self._met_s(box, history, moment)

    def _met_s(self, box: Box, history: History, moment: Moment) -> float:
        if self._target is None:
            return -math.inf
        then, target = self._target
        beside = _are_beside(box, history.warp(then, moment).box(target))
        return moment.captured_s if beside else -math.inf

    def claims(
        self, boxes: Sequence[Box], history: History, moment: Moment, all_of_them: bool = False
    ) -> list[list[float]]:
        """Return how well each established neighbour (rows) explains each box (columns), 0 to 1.

        Unless all of them are asked for, those count that are surely not the target.
        """
        rows = []
        for one in self._known:
            if one.hits >= _HITS_TO_CLAIM and (one.sure or all_of_them):
                row = [one.likeness(box, history, moment) for box in boxes]
                rows.append([value if value >= _CLAIM else 0.0 for value in row])
        return rows

    def see(
        self,
        boxes: Sequence[Box],
        strangers: Sequence[Box],
        history: History,
        moment: Moment,
        passers: Sequence[Box] = (),
    ) -> None:
        """Take what was seen besides the target.

        Args:
            boxes: all of that.
            strangers: those of them that are surely somebody else, known or not.
            history: has the frame.
            moment: the frame in which they were seen.
            passers: those of them that are somebody else in all likelihood.
        """
        left = list(boxes)
        for one in sorted(self._known, key=lambda known: -known.hits):
            values = [one.likeness(box, history, moment) for box in left]
            if values and max(values) >= _CLAIM:
                box = left.pop(values.index(max(values)))
                one.see(box, history, moment)
                one.sure = one.sure or box in strangers
        for box in left:
            if box in strangers or box in passers:
                met_s = self._met_s(box, history, moment)
                self._known.append(Neighbour(box, moment, met_s, sure=box in strangers))
        self._known = [one for one in self._known if one.age_s(moment) <= _KEPT_S][:_MOST]


def _are_beside(one: Box, other: Box) -> bool:
    """Whether half of one's size, or less, lies between two boxes."""
    return one.scaled(2.0).intersection(other) > 0


def assign_target(target: Sequence[float], claims: Sequence[Sequence[float]]) -> int | None:
    """Decide which of several boxes is the target.

    The choice with the largest sum of the target's own likeness and of what the neighbours make of
    the rest, each box belonging to one of them at most. So a box that fits a neighbour better is
    left to it, though it fits the target too.

    Args:
        target: the target's likeness for each box; 0 or less is impossible.
        claims: each neighbour's likeness for each box.

    Returns:
        The box's number, or None if leaving all to the neighbours fits best.
    """
    best, best_sum = None, _sum(claims, None)
    for number, value in enumerate(target):
        if value > 0:
            total = value + _sum(claims, number)
            if total > best_sum:
                best, best_sum = number, total
    return best


def claimed_boxes(boxes: Sequence[Box], claims: Sequence[Sequence[float]]) -> list[Box]:
    """Return the boxes that are the neighbours': one each at most, the best fits first.

    So a target that comes out beside a look-alike is left over.
    """
    return [boxes[column] for _, column in _shared_out(claims, None)]


def likeness(expected: Box, seen: Box, reach_px: float) -> float:
    """Return how well a box fits an expectation, 0 to 1: nearness and likeness of size."""
    near = math.exp(-((expected.distance(seen) / max(reach_px, 1.0)) ** 2))
    size = math.exp(-((2.0 * math.log(seen.scale / expected.scale)) ** 2))
    return near * size


def _sum(claims: Sequence[Sequence[float]], taken: int | None) -> float:
    return sum(claims[row][column] for row, column in _shared_out(claims, taken))


def _shared_out(claims: Sequence[Sequence[float]], taken: int | None) -> list[tuple[int, int]]:
    """Give every neighbour (row) the best box (column) that is left, the best fits first."""
    pairs = sorted(
        (
            (-value, row, column)
            for row, values in enumerate(claims)
            for column, value in enumerate(values)
            if value > 0 and column != taken
        )
    )
    rows: set[int] = set()
    columns: set[int] = set()
    shares = []
    for _, row, column in pairs:
        if row not in rows and column not in columns:
            rows.add(row)
            columns.add(column)
            shares.append((row, column))
    return shares
