"""A horizontal direction in which the vehicle may move only so fast."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

from follower_control.limit import Limit

ROUNDING = 1e-9
"""A velocity just brought to a bound may exceed it by this much, m/s."""


_STRAIGHT_RAD = math.radians(1)
_TURN_STEP_RAD = math.radians(20)


@dataclass(frozen=True, slots=True)
class Bound:
    """Velocities are complex numbers, forward + 1j * right.

    Attributes:
        direction: a complex number of length 1.
        max_speed_m_s: in that direction, not negative; standing still keeps every bound.
        limit: what it is there for.
    """

    direction: complex
    max_speed_m_s: float
    limit: Limit

    @classmethod
    def towards(cls, bearing_rad: float, max_speed_m_s: float, limit: Limit) -> Bound:
        """Make a bound on the speed towards a bearing from the nose, right is positive."""
        return cls(cmath.rect(1.0, bearing_rad), max_speed_m_s, limit)

    def turned(self, angle_rad: float) -> Bound:
        """Return the same bound for axes that are turned by minus this angle."""
        return Bound(self.direction * cmath.rect(1.0, angle_rad), self.max_speed_m_s, self.limit)

    def while_turning(self, turn_rad: float) -> tuple[Bound, ...]:
        """Return bounds that keep this one also while the axes turn, with the velocity in them."""
        if abs(turn_rad) < _STRAIGHT_RAD:
            return (self,)
        count = math.ceil(abs(turn_rad) / _TURN_STEP_RAD)
        return (self, *(self.turned(-turn_rad * (i + 1) / count) for i in range(count)))

    def excess(self, velocity: complex) -> float:
        """Return by how much a velocity is too fast in this direction, 0 if it is not."""
        return max(0.0, self.speed(velocity) - self.max_speed_m_s)

    def kept(self, velocity: complex) -> complex:
        """Take away what is too fast; motion across the direction stays."""
        return velocity - self.excess(velocity) * self.direction

    def share(self, velocity: complex) -> float:
        """Return what share of a velocity keeps the bound; 1 if all of it does."""
        speed = self.speed(velocity)
        return 1.0 if speed <= self.max_speed_m_s + ROUNDING else self.max_speed_m_s / speed

    def speed(self, velocity: complex) -> float:
        """Return how fast a velocity goes in this direction, negative if it goes the other way."""
        return (velocity * self.direction.conjugate()).real
