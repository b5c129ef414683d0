"""Tells a sensor that repeats itself from one that lives."""

from __future__ import annotations

import math

from follower_control.vehicle import Attitude


class Liveness:
    """How long attitudes have not changed, whatever time stamps they come with.

    A stream may go on while what feeds it has hung. A real attitude has noise: it never comes twice
    with the same six numbers.
    """

    def __init__(self) -> None:
        self._numbers: tuple[float, ...] | None = None
        self._changed_s = -math.inf

    def note(self, attitude: Attitude, now_s: float) -> None:
        """Look at an attitude that has come."""
        if attitude.numbers != self._numbers:
            self._numbers, self._changed_s = attitude.numbers, now_s

    def age_s(self, now_s: float) -> float:
        """Return how long the numbers have been the same, infinity before the first."""
        return now_s - self._changed_s
