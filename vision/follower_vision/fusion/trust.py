"""What a confidence or a likeness is worth."""

from __future__ import annotations

import math


class Trust:
    """Measures a value against what is usual for this target.

    Confidences of different motion trackers, and of one on different targets, do not compare.
    """

    def __init__(self, rise_s: float, fall_s: float) -> None:
        """Make one that adapts to larger and to smaller values with these time constants."""
        self._rise_s = rise_s
        self._fall_s = fall_s
        self._usual: float | None = None

    def relative(self, confidence: float) -> float:
        """Return a confidence as a share of the usual one, at most 1."""
        usual = confidence if self._usual is None else self._usual
        return min(1.0, confidence / usual) if usual > 0 else 0.0

    def learn(self, confidence: float, interval_s: float) -> None:
        """Take a confidence that belongs to a box believed; `interval_s` since the last one."""
        if self._usual is None:
            self._usual = confidence
        memory_s = self._rise_s if confidence > self._usual else self._fall_s
        self._usual += (1 - math.exp(-interval_s / memory_s)) * (confidence - self._usual)

    def reset(self, confidence: float) -> None:
        """Take a value as the usual one from now on."""
        self._usual = confidence
