"""Whether the turn that would be flown goes against a turn that a hand has made."""

from __future__ import annotations

import math

from follower.sign_test.evidence import Sign
from follower_vision.lineofsight import wrap_angle

_LEAST_INTERVAL_S, _LONGEST_INTERVAL_S = 0.15, 0.6
_FORGET = 0.99
_ENOUGH_RAD = math.radians(40)
_CLEAR_PER_S = 0.3


class Reaction:
    """Fits the change of the yaw rate asked for to the change of the heading.

    The vehicle is turned right by hand, the target stands: it is left of the nose now, and the turn
    asked for has to go to the left. The other way round the vehicle would spin away from it.
    """

    def __init__(self) -> None:
        self._last: tuple[float, float, float] | None = None
        self._squares = self._products = self._path = 0.0

    def add(self, time_s: float, yaw_rad: float, asked_rad_s: float) -> None:
        """Take the heading and the yaw rate asked for at one time."""
        if self._last is not None:
            last_s, last_yaw, last_asked = self._last
            if 0 <= time_s - last_s < _LEAST_INTERVAL_S:
                return
            if 0 <= time_s - last_s <= _LONGEST_INTERVAL_S:
                self._fold_in(wrap_angle(yaw_rad - last_yaw), asked_rad_s - last_asked)
        self._last = time_s, yaw_rad, asked_rad_s

    def judge(self) -> Sign:
        """Return what is known by now."""
        if self._path < _ENOUGH_RAD:
            return Sign.WAITING
        slope = self._products / self._squares
        if abs(slope) < _CLEAR_PER_S:
            return Sign.UNCLEAR
        return Sign.RIGHT if slope < 0 else Sign.REVERSED

    def _fold_in(self, turned_rad: float, changed_rad_s: float) -> None:
        self._path = _FORGET * self._path + abs(turned_rad)
        self._squares = _FORGET * self._squares + turned_rad**2
        self._products = _FORGET * self._products + turned_rad * changed_rad_s
