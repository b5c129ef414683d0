"""How like the target its surroundings look: what a score is worth depends on that."""

from __future__ import annotations

import math
from collections import deque

from follower_vision.box import Box
from follower_vision.frame import Image
from follower_vision.reidentify import Reidentifier
from follower_vision.targetsearch import TargetSearch

_EVERY_S = 0.2
_MEMORY_S = 1.5
_ASIDE = ((2.0, 0.0), (-2.0, 0.0), (0.0, 2.0), (0.0, -2.0))
_DIAGONAL = ((1.4, 1.4), (-1.4, -1.4), (1.4, -1.4), (-1.4, 1.4))
_LEAST_VISIBLE = 0.9
_REACH = 8.0
_OTHER_IOU = 0.1


class Surroundings:
    """Scores what is not the target as if it were a candidate, now and then.

    In turn: boxes beside the target, boxes diagonally from it, and what the search would propose.
    A tracker that has slid onto the background has a box that scores like the background; and
    in a picture full of look-alikes a score has to be higher to mean anything.
    """

    def __init__(self, reidentifier: Reidentifier, search: TargetSearch) -> None:
        self._reidentifier = reidentifier
        self._search = search
        self._levels: deque[tuple[float, float]] = deque()
        self._turn = 0

    def reset(self) -> None:
        """Forget the levels: another target."""
        self._levels.clear()

    @property
    def level(self) -> float | None:
        """Highest re-identification score (0 to 2) around the target of late.

        None while nothing was measured. It keeps its last value while nothing new is measured.
        """
        return max((level for _, level in self._levels), default=None)

    def update(self, image: Image, box: Box, now_s: float) -> None:
        """Measure around the target's box if it is time to; call it when the target is seen."""
        if self._levels and now_s < self._levels[-1][0] + _EVERY_S:
            return
        self._turn += 1
        level = self._measured(image, box)
        if math.isfinite(level):
            self._levels.append((now_s, level))
        while self._levels and self._levels[0][0] < now_s - _MEMORY_S:
            self._levels.popleft()

    def _measured(self, image: Image, box: Box) -> float:
        """Highest score of a few boxes; minus infinity if there are none."""
        scores = (self._reidentifier.score(image, place) for place in self._places(image, box))
        return max(scores, default=-math.inf)

    def _places(self, image: Image, box: Box) -> list[Box]:
        height, width = image.shape[:2]
        turn = self._turn % 3
        if turn == 0:
            found = self._search.everywhere(image, box, _REACH * box.scale)
            return [place for place in found if place.iou(box) < _OTHER_IOU]
        shifts = _DIAGONAL if turn == 1 else _ASIDE
        places = [box.moved_to(box.cx + x * box.width, box.cy + y * box.height) for x, y in shifts]
        return [place for place in places if place.visible_share(width, height) >= _LEAST_VISIBLE]
