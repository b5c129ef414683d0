"""A velocity that follows a wish with limited acceleration and jerk and never leaves its bounds.

Velocities in the plane are complex numbers: forward + 1j * right. One axis alone is a real part.
"""

from __future__ import annotations

import math
from collections.abc import Callable

BLEND_STEPS = 12


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
    def reach(self) -> float:
        """The largest speed on the way to where the velocity would come to rest by itself."""
        at_rest = self.velocity + self.acceleration * abs(self.acceleration) / (2 * self._max_jerk)
        return max(abs(self.velocity), abs(at_rest))

    def start(self, velocity: complex) -> None:
        """Begin at a steady velocity; outside the bounds it is scaled into them."""
        self.acceleration = 0.0
        self.velocity = velocity if self._is_within(velocity) else self._scaled_in(velocity)

    def step(self, wanted: complex, interval_s: float) -> complex:
        """Move towards `wanted`, which is finite, for `interval_s`; return the new velocity."""
        if interval_s <= 0:
            return self.velocity
        eased = self._moved_towards(0.0, interval_s)
        eager = self._moved_towards(self._approach(wanted, interval_s), interval_s)
        self.acceleration = self._most_eager(eased, eager, interval_s)
        self.velocity += self.acceleration * interval_s
        return self.velocity

    def _approach(self, wanted: complex, interval_s: float) -> complex:
        """Return the largest acceleration from which `wanted` can be reached without passing it.

        After one interval at acceleration a, taking it back covers another a**2 / (2 jerk):
        a * interval + a**2 / (2 jerk) = what is left.
        """
        left = wanted - self.velocity
        distance = abs(left)
        if distance < 1e-12:
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
