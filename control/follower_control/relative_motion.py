"""Where an estimate puts the target against us, and how that changes: horizontal vectors.

North + 1j * east in the world's frames, forward + 1j * right in the body's.
"""

from __future__ import annotations

import cmath
import math

from follower_control.estimate import TargetEstimate
from follower_control.sighting import SightFrame
from follower_control.vehicle import VehicleState


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


def own_velocity(estimate: TargetEstimate, vehicle: VehicleState, fresh_s: float) -> complex | None:
    """Return our own horizontal velocity, None if it is too old or the frame is not the world's."""
    position = vehicle.position
    fresh = vehicle.position_age_s(estimate.time_s) <= fresh_s
    if position is None or not fresh or estimate.frame is SightFrame.BODY:
        return None
    return complex(position.north_m_s, position.east_m_s)
