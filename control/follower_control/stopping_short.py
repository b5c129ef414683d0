"""Whether a vehicle that comes near a target will stop far enough from it."""

from __future__ import annotations

import cmath
import math

from follower_control.clip import clip
from follower_control.envelope_settings import EnvelopeSettings
from follower_control.flight_context import FlightContext

_ANSWERS, _STANDING_M = 0.6, 0.5
"""What share of the reaction time a vehicle needs that answers as usual, and who goes on for less
than this stands."""

_TO_SPARE_M = 0.75
"""How much farther away than asked still counts as too near."""


def moves_on_m(context: FlightContext, settings: EnvelopeSettings) -> float:
    """Return how far a target that moves away still goes, if it brakes as we do (Gipps, 1981)."""
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
