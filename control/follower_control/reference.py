"""What is wanted of a pursuit at this moment: the settings, and a nudge on top."""

from __future__ import annotations

import math

from follower_control.clip import clip
from follower_control.nudge import NO_NUDGE, Nudge

DISTANCE_M_S = 2.0
ANGLE_RAD_S = math.radians(15)
SIDE_M_S2 = 1.5
"""How fast a nudge takes effect, and how fast it is taken back."""

_NEAREST_SHARE = 0.25
_STEEPEST_RAD = math.radians(85)


class Reference:
    """Follows nudges smoothly.

    Without a nudge it is what the settings say, to the last bit.

    Args:
        distance_m: wanted distance. A nudge brings it down to a quarter of this at most.
        elevation_rad: wanted elevation of the target.

    Attributes:
        distance_m: wanted now.
        elevation_rad: wanted now.
        azimuth_rad: where the target is wanted, right of the nose.
        side_m_s: wanted velocity around the target, to the right.
    """

    def __init__(self, distance_m: float, elevation_rad: float) -> None:
        self._distance_m, self._elevation_rad = distance_m, elevation_rad
        self._nudge = NO_NUDGE
        self.start()

    def start(self) -> None:
        """Begin without any nudge having taken effect."""
        self.distance_m = self._distance_m
        self.elevation_rad = self._elevation_rad
        self.azimuth_rad = self.side_m_s = 0.0

    def change(self, distance_m: float, elevation_rad: float) -> None:
        """Go on towards another distance and elevation, as smoothly as after a nudge."""
        self._distance_m, self._elevation_rad = distance_m, elevation_rad

    def nudge(self, nudge: Nudge) -> None:
        """Go on towards this shift; one with a number that is not finite is no shift."""
        self._nudge = nudge if nudge.is_finite else NO_NUDGE

    def step(self, interval_s: float) -> None:
        """Let so much time pass."""
        turn = ANGLE_RAD_S * interval_s
        nearest = _NEAREST_SHARE * self._distance_m
        distance = max(self._distance_m + self._nudge.distance_m, nearest)
        elevation = clip(self._elevation_rad + self._nudge.elevation_rad, self._steepest)
        azimuth = clip(self._nudge.azimuth_rad, _STEEPEST_RAD)
        self.distance_m = _towards(self.distance_m, distance, DISTANCE_M_S * interval_s)
        self.elevation_rad = _towards(self.elevation_rad, elevation, turn)
        self.azimuth_rad = _towards(self.azimuth_rad, azimuth, turn)
        self.side_m_s = _towards(self.side_m_s, self._nudge.side_m_s, SIDE_M_S2 * interval_s)

    @property
    def _steepest(self) -> float:
        return max(_STEEPEST_RAD, abs(self._elevation_rad))


def _towards(present: float, wanted: float, reach: float) -> float:
    return (
        wanted
        if abs(wanted - present) <= reach
        else present + math.copysign(reach, wanted - present)
    )
