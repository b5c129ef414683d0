"""A step in what is asked for, taken out and let fade."""

from __future__ import annotations

import math

from follower_control.setpoint import HOLD, VelocitySetpoint


class Fade:
    """Makes a new law begin where the old one ended.

    Args:
        time_s: time constant with which the difference fades.

    Attributes:
        time_s: the same; may be changed.
    """

    def __init__(self, time_s: float) -> None:
        self.time_s = time_s
        self._present: VelocitySetpoint | None = None
        self._bump = HOLD

    def start(self, present: VelocitySetpoint | None = None) -> None:
        """Have the next setpoint begin at `present`, or wherever it is."""
        self._present = present
        self._bump = HOLD

    def update(self, asked: VelocitySetpoint, interval_s: float) -> VelocitySetpoint:
        """Return the setpoint with what is left of the difference."""
        if self._present is not None:
            self._bump = _sum(self._present, asked, -1.0)
            self._present = None
        elif self._bump is HOLD:
            return asked
        else:
            share = math.exp(-interval_s / self.time_s)
            self._bump = _sum(HOLD, self._bump, share)
        return _sum(asked, self._bump, 1.0)


def _sum(a: VelocitySetpoint, b: VelocitySetpoint, factor: float) -> VelocitySetpoint:
    numbers = (x + factor * y for x, y in zip(a.values, b.values, strict=True))
    return VelocitySetpoint(*numbers)
