"""A pilot's shift of what is wanted of a pursuit."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Nudge:
    """By how much the wanted place is shifted; the shift lasts for as long as it is given.

    Attributes:
        distance_m: added to the wanted distance; positive is farther away.
        elevation_rad: added to the wanted elevation of the target; positive brings the vehicle
            lower, so that it looks up more.
        azimuth_rad: how far right of the nose the target is kept; negative turns the nose to the
            right of it.
        side_m_s: velocity around the target, to the right as seen from the vehicle. While `side`
            keeps a bearing, this moves it, and it stays where it was moved to.
    """

    distance_m: float = 0.0
    elevation_rad: float = 0.0
    azimuth_rad: float = 0.0
    side_m_s: float = 0.0

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite."""
        return all(map(math.isfinite, self.values))

    @property
    def values(self) -> tuple[float, float, float, float]:
        """(distance, elevation, azimuth, side) in m, rad, rad and m/s."""
        return self.distance_m, self.elevation_rad, self.azimuth_rad, self.side_m_s


NO_NUDGE = Nudge()
"""Everything as the settings say."""
