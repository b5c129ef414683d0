"""From local metres to latitude and longitude."""

from __future__ import annotations

import math
from dataclasses import dataclass

from follower.ground_station.flight_view import FlightView
from follower_control.target_fix import TargetFix

_EARTH_M = 6_371_000.0
"""Mean radius; over a kilometre the ellipsoid makes less than 4 m of difference."""


@dataclass(frozen=True, slots=True)
class Place:
    """A target's fix on the globe.

    Attributes:
        latitude_deg: north is positive.
        longitude_deg: east is positive.
        altitude_m: above mean sea level.
        above_home_m: above the origin of local positions.
        fix: in local metres.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float
    above_home_m: float
    fix: TargetFix


def target_place(view: FlightView, now_s: float) -> Place | None:
    """Return where the target is on the globe, None if that is not known now."""
    fix, step = view.fix(now_s), view.step(now_s)
    altitude_m = view.link.altitude_msl_m
    if fix is None or step is None or altitude_m is None:
        return None
    origin, position = step.vehicle.origin, step.vehicle.position
    if origin is None or position is None:
        return None
    north, east, down = fix.position_m
    latitude = origin.latitude_deg + math.degrees(north / _EARTH_M)
    across = _EARTH_M * math.cos(math.radians(origin.latitude_deg))
    longitude = origin.longitude_deg + math.degrees(east / across)
    above_us_m = -down - position.height_m
    return Place(latitude, longitude, altitude_m + above_us_m, -down, fix)
