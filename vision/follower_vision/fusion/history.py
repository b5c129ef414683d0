"""What was believed in the last frames, so that late answers can be brought to the present."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

from follower_vision.box import Box
from follower_vision.fusion.warp import Warp

_KEPT_S = 2.12
_MOST_ZOOM = 10.0
_MOST_STRETCHES = 16


@dataclass(slots=True)
class Moment:
    """One frame.

    Attributes:
        index: counts the frames stepped, from 0.
        captured_s: the frame's capture time.
        stretch: counts the stretches of the flight, from 0; see `History`.
        total: the camera's motion from its stretch's beginning to this frame.
        box: where the target was believed to be.
    """

    index: int
    captured_s: float
    stretch: int
    total: Warp
    box: Box


class History:
    """The frames of the last two seconds: 64 of a camera with 30 a second.

    Who flies forward sees everything become larger for ever. So motions are counted from the
    beginning of a stretch of the flight, and a stretch ends before its zoom (here: exp(10)) takes
    the pixels from the numbers' precision.
    """

    def __init__(self) -> None:
        self._moments: deque[Moment] = deque()
        self._stretches: list[Warp] = []

    def add(self, captured_s: float, warp: Warp, box: Box) -> Moment:
        """Append a frame that the camera reached by `warp`, and return it."""
        index = self._moments[-1].index + 1 if self._moments else 0
        total = self._moments[-1].total.then(warp) if self._moments else warp
        if abs(math.log(total.zoom)) > _MOST_ZOOM:
            self._stretches.append(total)
            total = Warp()
        self._moments.append(Moment(index, captured_s, len(self._stretches), total, box))
        while captured_s - self._moments[0].captured_s > _KEPT_S:
            self._moments.popleft()
        return self._moments[-1]

    @property
    def now(self) -> Moment:
        """The newest frame."""
        return self._moments[-1]

    def at(self, index: int) -> Moment | None:
        """Return a frame by its number; None if it is too old."""
        place = index - self._moments[0].index
        return self._moments[place] if 0 <= place < len(self._moments) else None

    def since(self, captured_s: float) -> Moment | None:
        """Return the last frame up to a time; None if that is too long ago."""
        if self._moments[0].captured_s > captured_s:
            return None
        return next(one for one in reversed(self._moments) if one.captured_s <= captured_s)

    def warp(self, first: Moment, second: Moment) -> Warp:
        """Return the camera's motion from one frame to another.

        Of very long ago the latest part alone, some sixteen stretches.
        """
        if first.stretch > second.stretch:
            return self.warp(second, first).back()
        motion = first.total.back()
        for whole in self._stretches[first.stretch : second.stretch][-_MOST_STRETCHES:]:
            motion = motion.then(whole)
        return motion.then(second.total)
