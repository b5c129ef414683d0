"""A velocity that follows a setpoint with limited acceleration and jerk, within its bounds.

Velocities in the plane are complex numbers: forward + 1j * right. One axis alone is a real part.
A yaw rate is such an axis, too: then read rad/s for m/s.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

BLEND_STEPS = 12

ROUNDING = 1e-9
"""A velocity just brought to a bound may exceed it by this much, m/s."""
_ARRIVED = 1e-12
"""So near, a velocity is the wanted one, m/s: a hold ends with zero, not almost."""
_STRAIGHT_RAD = math.radians(1)
_TURN_STEP_RAD = math.radians(20)


class JerkLimit:
    """Brings a velocity to a wanted one as fast as the limits allow.

    The state is the velocity v and the acceleration a with which the last step was made. Two
    things hold after every step, whatever is asked for and however long the steps are:

    - v is within bounds;
    - so is v + a |a| / (2 jerk), where v would come to rest if from now on the acceleration were
      taken back as fast as the jerk allows.

    Taking the acceleration back keeps both true (the bounds are convex, and v moves along the
    straight line between the two), so there is always a step that stays within all limits.

    Args:
        max_acceleration: largest change of velocity per second, m/s2.
        max_jerk: largest change of acceleration per second, m/s3.
        is_within: whether a velocity is within bounds: a convex set around zero.
    """

    def __init__(
        self, max_acceleration: float, max_jerk: float, is_within: Callable[[complex], bool]
    ) -> None:
        self._max_acceleration = max_acceleration
        self._max_jerk = max_jerk
        self._is_within = is_within
        self.velocity: complex = 0.0
        self.acceleration: complex = 0.0

    @property
    def at_rest(self) -> complex:
        """The velocity, m/s, that is reached by taking the acceleration back from now on."""
        return self.velocity + self.acceleration * abs(self.acceleration) / (2 * self._max_jerk)

    @property
    def reach(self) -> float:
        """The largest speed, m/s, on the way to where the velocity would come to rest by itself."""
        return max(abs(self.velocity), abs(self.at_rest))

    def start(self, velocity: complex) -> None:
        """Begin at a steady velocity; outside the bounds it is scaled into them."""
        self.acceleration = 0.0
        self.velocity = velocity if self._is_within(velocity) else self._scaled_in(velocity)

    def step(self, wanted: complex, interval_s: float) -> complex:
        """Move towards `wanted`, which is finite, for `interval_s`.

        Return the new velocity, m/s.
        """
        if interval_s <= 0:
            return self.velocity
        eased = self._moved_towards(0.0, interval_s)
        eager = self._moved_towards(self._approach(wanted, interval_s), interval_s)
        self.acceleration = self._most_eager(eased, eager, interval_s)
        velocity = self.velocity + self.acceleration * interval_s
        self.velocity = wanted if abs(wanted - velocity) <= _ARRIVED else velocity
        return self.velocity

    def _approach(self, wanted: complex, interval_s: float) -> complex:
        """Return the largest acceleration from which `wanted` can be reached without passing it.

        After one interval at acceleration a, taking it back covers another a**2 / (2 jerk):
        a * interval + a**2 / (2 jerk) = what is left.
        """
        left = wanted - self.velocity
        distance = abs(left)
        if distance == 0:
            return 0.0
        jerk = self._max_jerk
        size = 2 * distance / (interval_s + math.sqrt(interval_s**2 + 2 * distance / jerk))
        return left / distance * min(size, self._max_acceleration)

    def _moved_towards(self, acceleration: complex, interval_s: float) -> complex:
        """Return the present acceleration, moved towards another as far as the jerk allows."""
        change = acceleration - self.acceleration
        reach = self._max_jerk * interval_s
        return (
            acceleration
            if abs(change) <= reach
            else self.acceleration + change * (reach / abs(change))
        )

    def _most_eager(self, eased: complex, eager: complex, interval_s: float) -> complex:
        """Return the acceleration nearest to `eager`, on the way from `eased`, that is safe."""
        if self._is_safe(eager, interval_s):
            return eager
        low, high = 0.0, 1.0
        for _ in range(BLEND_STEPS):
            middle = (low + high) / 2
            if self._is_safe(eased + middle * (eager - eased), interval_s):
                low = middle
            else:
                high = middle
        return eased + low * (eager - eased)

    def _is_safe(self, acceleration: complex, interval_s: float) -> bool:
        velocity = self.velocity + acceleration * interval_s
        at_rest = velocity + acceleration * abs(acceleration) / (2 * self._max_jerk)
        return self._is_within(velocity) and self._is_within(at_rest)

    def _scaled_in(self, velocity: complex) -> complex:
        low, high = 0.0, 1.0
        for _ in range(50):
            middle = (low + high) / 2
            low, high = (middle, high) if self._is_within(velocity * middle) else (low, middle)
        return velocity * low


class Limit(StrEnum):
    """What kept a setpoint from being allowed as asked."""

    NOT_FINITE = "not finite"
    SPEED = "speed"
    DOUBT = "doubtful estimate"
    CLIMB = "climb speed"
    DESCENT = "descent speed"
    YAW_RATE = "yaw rate"
    MIN_HEIGHT = "minimum height"
    MIN_CLEARANCE = "minimum clearance"
    CEILING = "ceiling"
    HEIGHT_UNKNOWN = "height unknown"
    FENCE = "fence"
    POSITION_UNKNOWN = "position unknown"
    TARGET_NEAR = "minimum distance"
    RANGE_UNKNOWN = "range unknown"
    ACCELERATION = "acceleration"
    YAW_ACCELERATION = "yaw acceleration"


@dataclass(frozen=True, slots=True)
class VelocityBound:
    """A speed limit in one direction; velocities are complex numbers, forward + 1j * right, m/s.

    Attributes:
        direction: a complex number of length 1.
        max_speed_m_s: in that direction, not negative; standing still keeps every bound.
        limit: what it is there for.
    """

    direction: complex
    max_speed_m_s: float
    limit: Limit

    @classmethod
    def towards(cls, bearing_rad: float, max_speed_m_s: float, limit: Limit) -> VelocityBound:
        """Make a bound on the speed, m/s, towards a bearing from the nose, rad.

        Right is positive.
        """
        return cls(cmath.rect(1.0, bearing_rad), max_speed_m_s, limit)

    def turned(self, angle_rad: float) -> VelocityBound:
        """Return the same bound for axes that are turned by minus this angle, rad."""
        return VelocityBound(
            self.direction * cmath.rect(1.0, angle_rad), self.max_speed_m_s, self.limit
        )

    def while_turning(self, turn_rad: float) -> tuple[VelocityBound, ...]:
        """Return bounds that keep this one also while the axes turn, with the velocity in them."""
        if abs(turn_rad) < _STRAIGHT_RAD:
            return (self,)
        count = math.ceil(abs(turn_rad) / _TURN_STEP_RAD)
        return (self, *(self.turned(-turn_rad * (i + 1) / count) for i in range(count)))

    def excess(self, velocity: complex) -> float:
        """Return by how many m/s a velocity is too fast in this direction, 0 if it is not."""
        return max(0.0, self.speed(velocity) - self.max_speed_m_s)

    def kept(self, velocity: complex) -> complex:
        """Take away what is too fast; motion across the direction stays."""
        return velocity - self.excess(velocity) * self.direction

    def share(self, velocity: complex) -> float:
        """Return what share of a velocity keeps the bound; 1 if all of it does."""
        speed = self.speed(velocity)
        return 1.0 if speed <= self.max_speed_m_s + ROUNDING else self.max_speed_m_s / speed

    def speed(self, velocity: complex) -> float:
        """Return a velocity's speed in this direction, m/s, negative if it goes the other way."""
        return (velocity * self.direction.conjugate()).real
