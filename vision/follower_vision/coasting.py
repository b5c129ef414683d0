"""Where a target would be if it went on as it did."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from follower_vision.box import Box

_MEMORY_S = 0.4
_LEAST_SPAN_S = 0.06
_FADE_S = 0.5


class Coasting:
    """Extrapolates a box by its velocity in the image over the last 0.4 s; the size stays.

    The velocity fades (time constant 0.5 s), because a guess gets worse with time and a drone
    that has stopped seeing its target stops turning with it.
    """

    def __init__(self) -> None:
        self._seen: deque[tuple[float, Box]] = deque()

    def reset(self) -> None:
        """Forget what was seen."""
        self._seen.clear()

    def add(self, captured_s: float, box: Box) -> None:
        """Remember a box that was really seen, at a time later than the last one's."""
        self._seen.append((captured_s, box))
        while self._seen[0][0] < captured_s - _MEMORY_S:
            self._seen.popleft()

    @property
    def last(self) -> tuple[float, Box]:
        """When the target was last seen, and where.

        Raises:
            RuntimeError: it was never seen.
        """
        if not self._seen:
            raise RuntimeError("no box was seen yet")
        return self._seen[-1]

    def predict(self, time_s: float) -> Box:
        """Return the box expected at `time_s`."""
        last_s, box = self.last
        right, down = self._velocity()
        reach_s = _FADE_S * (1 - math.exp(-max(0.0, time_s - last_s) / _FADE_S))
        return box.moved_to(box.cx + right * reach_s, box.cy + down * reach_s)

    def _velocity(self) -> tuple[float, float]:
        """Least-squares velocity in pixels a second; none while the memory is too short."""
        times = np.array([time_s for time_s, _ in self._seen])
        if times[-1] - times[0] < _LEAST_SPAN_S:
            return 0.0, 0.0
        centred = times - times.mean()
        places = np.array([(box.cx, box.cy) for _, box in self._seen])
        slope = centred @ places / (centred @ centred)
        return float(slope[0]), float(slope[1])
