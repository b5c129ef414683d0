"""Where the target goes, from our own velocity and how it moves against us."""

from __future__ import annotations

import cmath

from follower_control.target_speed import TargetSpeed

_UNDER_WAY_M_S = 1.0
"""A target that is slower has no course of its own; it keeps the one it had."""


class TargetMotion:
    """The target's horizontal velocity and its course; vectors are north + 1j * east.

    Args:
        filter_s: time constant of the velocity.
        own_lag_s: by how much our own velocity is held back; see `TargetSpeed`.
    """

    def __init__(self, filter_s: float, own_lag_s: float) -> None:
        self._north = TargetSpeed(filter_s, own_lag_s)
        self._east = TargetSpeed(filter_s, own_lag_s)
        self.start()

    def start(self) -> None:
        """Forget everything: there is no course before the target goes somewhere."""
        self._course_rad: float | None = None
        self.reset()

    def change(self, filter_s: float, own_lag_s: float) -> None:
        """Go on with other time constants."""
        self._north.change(filter_s, own_lag_s)
        self._east.change(filter_s, own_lag_s)

    def reset(self) -> None:
        """Forget the velocity; the course stays."""
        self._north.reset()
        self._east.reset()
        self.velocity_m_s: complex = 0.0

    @property
    def course_rad(self) -> float | None:
        """Where the target goes, from north; where it went last if it stands; None before."""
        return self._course_rad

    def update(self, own_m_s: complex, relative_m_s: complex, interval_s: float) -> complex:
        """Return the target's velocity.

        Args:
            own_m_s: our own velocity.
            relative_m_s: the rate of the vector from us to the target.
            interval_s: since the last update; 0 changes nothing.
        """
        self.velocity_m_s = complex(
            self._north.update(own_m_s.real, relative_m_s.real, interval_s),
            self._east.update(own_m_s.imag, relative_m_s.imag, interval_s),
        )
        if abs(self.velocity_m_s) > _UNDER_WAY_M_S:
            self._course_rad = cmath.phase(self.velocity_m_s)
        return self.velocity_m_s
