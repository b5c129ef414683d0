"""Where an estimate puts the target against us, and how that changes: horizontal vectors.

North + 1j * east in the world's frames, forward + 1j * right in the body's.
"""

from __future__ import annotations

import cmath
import math

from follower_control.attitude_history import turned_on
from follower_control.estimate import TargetEstimate
from follower_control.sighting import SightFrame
from follower_control.vehicle import VehicleState

OLD_S = 0.5
"""Older telemetry is not used; after a longer pause the loops begin anew."""

_AHEAD_S = 0.1


def offset(estimate: TargetEstimate, range_m: float) -> complex:
    """Return the horizontal vector from us to a target at this distance, metres."""
    ahead, right, _ = estimate.direction.tolist()
    return range_m * complex(ahead, right)


def offset_rate(estimate: TargetEstimate, range_m: float) -> complex:
    """Return the rate of `offset`, m/s: what the target's own motion and ours make together."""
    closing = -estimate.log_scale_rate_s * offset(estimate, range_m)
    azimuth, elevation = estimate.azimuth_rad, estimate.elevation_rad
    turn, rise = estimate.azimuth_rate_rad_s, estimate.elevation_rate_rad_s
    level, steep = math.cos(elevation), math.sin(elevation)
    if estimate.frame is SightFrame.DOWN:
        east = level * math.cos(azimuth) * turn - steep * math.sin(azimuth) * rise
        return closing + range_m * complex(level * rise, east)
    return closing + range_m * cmath.rect(1.0, azimuth) * complex(-steep * rise, level * turn)


def level_rate(estimate: TargetEstimate, range_m: float) -> float:
    """Return how fast the horizontal distance to a target at this distance grows, m/s."""
    away = cmath.phase(offset(estimate, range_m))
    return (offset_rate(estimate, range_m) * cmath.rect(1.0, -away)).real


def azimuth_of(estimate: TargetEstimate) -> float:
    """Return the azimuth from north, or from the nose in the body's frame."""
    if estimate.frame is SightFrame.DOWN:
        return cmath.phase(offset(estimate, 1.0))
    return estimate.azimuth_rad


def heading_at(estimate: TargetEstimate, vehicle: VehicleState) -> float | None:
    """Return the heading at the estimate's time, in the estimate's frame; None if unknown."""
    if estimate.frame is SightFrame.BODY:
        return 0.0
    age_s = vehicle.attitude_age_s(estimate.time_s)
    if vehicle.attitude is None or age_s > OLD_S:
        return None
    return turned_on(vehicle.attitude, min(max(age_s, -_AHEAD_S), _AHEAD_S)).yaw_rad


def centred_share(azimuth_rad: float, centred_rad: float, off_axis_rad: float) -> float:
    """Return 1 for a target ahead, falling smoothly to 0 for one off-axis."""
    x = min(max((off_axis_rad - abs(azimuth_rad)) / (off_axis_rad - centred_rad), 0.0), 1.0)
    return x * x * (3 - 2 * x)
