"""How far away a target can be at most: the line of sight ends on the ground."""

from __future__ import annotations

import math

_LOWEST_M = 1.0
"""Below this height, its error is too large a share of it for a range."""
_FLATTEST_RAD = math.radians(5)
"""So flat a line of sight meets the ground far away, and the error of the angle counts most."""
_MARGIN = 1.25
"""What slopes and the error of the height may add."""


def range_to_ground(height_m: float, elevation_rad: float) -> float:
    """Return how far a line of sight reaches before it meets level ground, with some margin.

    No target is farther away than that, whatever its box says: a box that has shrunk onto a part
    of the target must not pull the vehicle into it. Infinite where nothing can be said: close to
    the ground, and for a flat or rising line of sight.

    Args:
        height_m: above the ground, taken to be level.
        elevation_rad: of the line of sight from the horizontal, negative looks down.
    """
    if height_m < _LOWEST_M or elevation_rad > -_FLATTEST_RAD:
        return math.inf
    return _MARGIN * height_m / math.sin(-elevation_rad)
