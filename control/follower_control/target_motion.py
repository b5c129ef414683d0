"""Where the target goes: its velocity, smoothed, and its course."""

from __future__ import annotations

import cmath

_UNDER_WAY_M_S = 1.0
"""A target that is slower has no course of its own; it keeps the one it had."""


class TargetMotion:
    """The target's horizontal velocity and its course; vectors are north + 1j * east.

    Args:
        filter_s: time constant of the velocity.
    """

    def __init__(self, filter_s: float) -> None:
        self.change(filter_s)
        self.start()

    def start(self) -> None:
        """Forget everything: there is no course before the target goes somewhere."""
        self._course_rad: float | None = None
        self.reset()

    def change(self, filter_s: float) -> None:
        """Go on with another time constant."""
        self._filter_s = filter_s

    def reset(self) -> None:
        """Forget the velocity; the course stays."""
        self._known = False
        self.velocity_m_s: complex = 0.0

    @property
    def course_rad(self) -> float | None:
        """Where the target goes, from north; where it went last if it stands; None before."""
        return self._course_rad

    def update(self, velocity_m_s: complex, interval_s: float) -> complex:
        """Return the target's velocity, smoothed.

        Args:
            velocity_m_s: as it is seen now.
            interval_s: since the last update; 0 changes nothing.
        """
        if not self._known:
            self.velocity_m_s, self._known = velocity_m_s, True
        elif interval_s > 0:
            share = interval_s / (interval_s + self._filter_s)
            self.velocity_m_s += share * (velocity_m_s - self.velocity_m_s)
        if abs(self.velocity_m_s) > _UNDER_WAY_M_S:
            self._course_rad = cmath.phase(self.velocity_m_s)
        return self.velocity_m_s
