"""Tells a sensor that repeats itself from one that lives."""

from __future__ import annotations

import math

from follower_control.vehicle import Attitude, LocalPosition

_MOVING_M_S = 0.3
_SENT_M = 2.0
REPEATS = 5
"""After so many repetitions in a row a sensor is not waited for any longer: it hangs."""


class Liveness:
    """How long attitudes have not changed, whatever time stamps they come with.

    A stream may go on while what feeds it has hung. A real attitude has noise: it never comes twice
    with the same six numbers. At 50 of them a second a hang is known after a tenth of a second.
    """

    def __init__(self) -> None:
        self._numbers: tuple[float, ...] | None = None
        self._changed_s = -math.inf
        self._repeats = 0

    def note(self, attitude: Attitude, now_s: float) -> None:
        """Look at a new attitude that has come."""
        if attitude.numbers != self._numbers:
            self._numbers, self._changed_s, self._repeats = attitude.numbers, now_s, 0
        else:
            self._repeats += 1

    def age_s(self, now_s: float) -> float:
        """Return how long the numbers have been the same.

        Infinity before the first, and where they have been repeated too often to be waited for.
        """
        return math.inf if self._repeats >= REPEATS else now_s - self._changed_s


class PositionLiveness:
    """How long positions have contradicted themselves.

    One that stays the same to the last bit while it tells of a velocity is fed by nobody, and so is
    one that stays the same while the vehicle is sent metres away; that is believed again when it
    changes. One that tells of standing still may else be the same for long: it may be measured
    coarsely.
    """

    def __init__(self) -> None:
        self._last: LocalPosition | None = None
        self._moved_s = -math.inf
        self._repeats = 0
        self._sent_m = 0.0

    def note(self, position: LocalPosition | None, now_s: float, sent_m: float = 0.0) -> None:
        """Look at the newest position, the same one again if there is no newer.

        Args:
            position: the newest.
            now_s: the time.
            sent_m: how far setpoints that are flown have sent the vehicle since the last call.
        """
        last, self._last = self._last, position
        self._sent_m += sent_m
        if position is None or position is last:
            return
        if last is None or last.numbers != position.numbers:
            self._sent_m = 0.0
        if self._sent_m > _SENT_M:
            self._repeats = REPEATS
        elif last is None or not _is_stuck(last, position):
            self._moved_s, self._repeats = now_s, 0
        else:
            self._repeats += 1

    def age_s(self, now_s: float) -> float:
        """Return how long none has come that can be believed.

        Infinity before the first, and where one has been repeated too often to be waited for.
        """
        return math.inf if self._repeats >= REPEATS else now_s - self._moved_s


def _is_stuck(last: LocalPosition, position: LocalPosition) -> bool:
    moves = math.hypot(position.north_m_s, position.east_m_s, position.down_m_s) > _MOVING_M_S
    return moves and last.numbers == position.numbers
