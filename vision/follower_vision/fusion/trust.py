"""What a confidence or a likeness is worth."""

from __future__ import annotations

import math


class Trust:
    """Measures a value against what is usual for this target.

    Confidences of different motion trackers, and of one on different targets, do not compare.
    """

    def __init__(self, memory_s: float) -> None:
        """Make one that forgets with a time constant of `memory_s`."""
        self._memory_s = memory_s
        self._usual: float | None = None

    def relative(self, confidence: float) -> float:
        """Return a confidence as a share of the usual one, at most 1."""
        usual = confidence if self._usual is None else self._usual
        return min(1.0, confidence / usual) if usual > 0 else 0.0

    def learn(self, confidence: float, interval_s: float) -> None:
        """Take a confidence that belongs to a box believed; `interval_s` since the last one."""
        if self._usual is None:
            self._usual = confidence
        share = 1 - math.exp(-interval_s / self._memory_s)
        self._usual += share * (confidence - self._usual)
