"""What the envelope has to know about the flight."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

from follower_control.common.small_matrix import clip
from follower_control.envelope.settings import EnvelopeSettings
from follower_control.vehicle.state import VehicleState

_STALE_S, _VELOCITY_STALE_S = 1.0, 0.3
"""Ages from which a place and a velocity are not known. The second is short: what brakes against a
velocity of some time ago drives the vehicle back after it has stopped."""

_ANSWERS, _STANDING_M = 0.6, 0.5
"""What share of the reaction time a vehicle needs that answers as usual, and who goes on for less
than this stands."""
_TO_SPARE_M = 0.75
"""How much farther away than asked still counts as too near."""


@dataclass(frozen=True, slots=True)
class FlightContext:
    """Where the vehicle and its target are; None is what is not known.

    Attributes:
        yaw_rad: heading from north.
        north_m: position north of home, the fence's centre.
        east_m: position east of home.
        height_m: height above home.
        north_m_s: our own velocity to the north.
        east_m_s: our own velocity to the east.
        target_range_m: distance to the target.
        target_bearing_rad: the target's azimuth from the nose, right is positive.
        target_speed_m_s: how fast the target itself moves away along the line of sight.
        target_elevation_rad: the target's elevation from the horizontal; None counts as level.
        clearance_m: height above what is below, by a rangefinder or a terrain map.
        trust: what share of the largest speed may be flown on the estimate; None is all of it.
        home_deg: latitude and longitude of home.
    """

    yaw_rad: float | None = None
    north_m: float | None = None
    east_m: float | None = None
    height_m: float | None = None
    target_range_m: float | None = None
    target_bearing_rad: float | None = None
    target_speed_m_s: float | None = None
    target_elevation_rad: float | None = None
    clearance_m: float | None = None
    north_m_s: float | None = None
    east_m_s: float | None = None
    trust: float | None = None
    home_deg: tuple[float, float] | None = None

    @classmethod
    def of(cls, vehicle: VehicleState, now_s: float) -> FlightContext:
        """Take what is fresh of the vehicle's state."""
        attitude = vehicle.attitude if vehicle.attitude_age_s(now_s) <= _STALE_S else None
        position = vehicle.position if vehicle.position_age_s(now_s) <= _STALE_S else None
        fresh = vehicle.position_age_s(now_s) <= _VELOCITY_STALE_S
        # On the ground it stands: the estimator's velocity is noise, which a hold would brake.
        moving = position if fresh and not vehicle.landed else None
        origin = vehicle.origin
        north_m, east_m = position.from_home_m if position else (None, None)
        home_m = position.home_m[:2] if position and position.home_m else (0.0, 0.0)
        return cls(
            clearance_m=vehicle.fresh_clearance_m(now_s),
            home_deg=origin.geolocated(*home_m) if origin and position else None,
            yaw_rad=attitude.yaw_rad if attitude else None,
            north_m=north_m,
            east_m=east_m,
            height_m=position.height_m if position else None,
            north_m_s=moving.north_m_s if moving else None,
            east_m_s=moving.east_m_s if moving else None,
        )

    def known(self, *names: str) -> tuple[float, ...] | None:
        """Return the named numbers, None if any of them is missing or not finite."""
        values = [getattr(self, name) for name in names]
        usable = None not in values and all(map(math.isfinite, values))
        return tuple(values) if usable else None


def moves_on_m(context: FlightContext, settings: EnvelopeSettings) -> float:
    """Return how many metres a target that moves away still goes, braking as we do (Gipps.

    1981).
    """
    (target_speed,) = context.known("target_speed_m_s") or (0.0,)
    # However fast it is: more than our own speed is not needed, and might not be true.
    speed_m_s = clip(max(target_speed, 0.0), settings.max_speed_m_s)
    return speed_m_s**2 / (2 * settings.braking_m_s2)


def too_near_m(context: FlightContext, sent_m_s: complex, settings: EnvelopeSettings) -> float:
    """Return by how much too near a vehicle would stop to a target below that stays at its height.

    It is taken to brake as hard as it may. Not positive is far enough, or not known.

    Args:
        context: where both are and how they move.
        sent_m_s: the velocity that was sent last, forward + 1j * right.
        settings: `min_distance_m` is what to keep.
    """
    nearest_m = settings.min_distance_m
    place = context.known("target_range_m", "target_bearing_rad", "target_elevation_rad")
    moving = context.known("yaw_rad", "north_m_s", "east_m_s")
    if nearest_m is None or place is None or moving is None or place[2] >= 0:
        return 0.0
    range_m, bearing, elevation = place
    towards = cmath.rect(1.0, -bearing)
    own_m_s = (complex(*moving[1:]) * cmath.rect(1.0, -moving[0]) * towards).real
    # What answers late by a time goes on by its velocity times that, beyond what is sent.
    goes_on_m = max(own_m_s, 0.0) * _ANSWERS * settings.reaction_s
    braking_m_s = max((sent_m_s * towards).real, 0.0)
    goes_on_m += braking_m_s**2 / (2 * settings.max_acceleration_m_s2)
    if goes_on_m < _STANDING_M:
        return 0.0
    left_m = range_m * math.cos(elevation) + moves_on_m(context, settings) - goes_on_m
    stops_m = math.hypot(max(left_m, 0.0), range_m * math.sin(elevation))
    return nearest_m + _TO_SPARE_M - stops_m
