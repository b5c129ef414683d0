"""How far away a target can be at most: the line of sight ends on the ground."""

import math
from dataclasses import replace

from follower_control.target.estimate import TargetEstimate
from follower_control.target.observation import BearingFrame

_LOWEST_M = 1.0
"""Below this height, its error is too large a share of it for a range."""
_FLATTEST_RAD = math.radians(5)
"""So flat a line of sight meets the ground far away, and the error of the angle counts most."""
_MARGIN = 1.25
"""What slopes and the error of the height may add."""


def range_to_ground(height_m: float, elevation_rad: float) -> float:
    """Return after how many metres a line of sight meets level ground, with some margin.

    No target is farther away than that, whatever its box says: a box that has shrunk onto a part
    of the target must not pull the vehicle into it. Infinite where nothing can be said: close to
    the ground, and for a flat or rising line of sight.

    Args:
        height_m: above the ground, taken to be level.
        elevation_rad: of the line of sight from the horizontal, negative looks down; a prediction
            that has passed below us counts as straight down.
    """
    elevation_rad = max(elevation_rad, -math.pi / 2)
    if height_m < _LOWEST_M or elevation_rad > -_FLATTEST_RAD:
        return math.inf
    return _MARGIN * height_m / math.sin(-elevation_rad)


def ranged_by_ground(
    estimate: TargetEstimate, size_m: float, above_m: float, climb_m_s: float
) -> TargetEstimate:
    """Return the estimate with the size that fits to where its line of sight meets the ground.

    Unchanged where nothing can be said: too low, too flat a line of sight, or no telemetry.

    Args:
        estimate: of a target on the ground.
        size_m: the size in metres that stands for the target.
        above_m: our height above the target's middle.
        climb_m_s: how fast that grows.
    """
    elevation = max(estimate.height_angle_rad, -math.pi / 2)
    if above_m < _LOWEST_M or elevation > -_FLATTEST_RAD or estimate.frame is BearingFrame.BODY:
        return estimate
    range_m = above_m / math.sin(-elevation)
    growth = climb_m_s / above_m
    if estimate.frame is BearingFrame.WORLD:
        growth -= estimate.elevation_rate_rad_s / math.tan(elevation)
    return replace(estimate, log_scale=math.log(size_m / range_m), log_scale_rate_s=-growth)
