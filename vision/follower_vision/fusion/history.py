"""What was believed in the last frames, so that late answers can be brought to the present."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from follower_vision.box import Box
from follower_vision.fusion.warp import Warp

_LENGTH = 64


@dataclass(slots=True)
class Moment:
    """One frame.

    Attributes:
        index: counts the frames stepped, from 0.
        captured_s: the frame's capture time.
        total: the camera's motion from the first frame of all to this one.
        box: where the target was believed to be.
    """

    index: int
    captured_s: float
    total: Warp
    box: Box


class History:
    """The last 64 frames."""

    def __init__(self) -> None:
        self._moments: deque[Moment] = deque(maxlen=_LENGTH)

    def add(self, captured_s: float, warp: Warp, box: Box) -> Moment:
        """Append a frame that the camera reached by `warp`, and return it."""
        index = self._moments[-1].index + 1 if self._moments else 0
        total = self._moments[-1].total.then(warp) if self._moments else warp
        self._moments.append(Moment(index, captured_s, total, box))
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
        """Return the camera's motion from one frame to another."""
        return first.total.back().then(second.total)
