"""How fast a target below may be closed in on without losing it below the image."""

from __future__ import annotations

import math

_LEVEL_RAD, _STEEPEST_RAD = math.radians(1), math.radians(60)
_BACK_PER_S = 0.5
"""How fast an elevation at which the target is too low is to shrink, per second."""


def fastest_closing_m_s(
    elevation_rad: float, error_rad: float, range_m: float, sink_m_s: float
) -> float:
    """Return how fast the level distance to a target may shrink, not negative.

    Its elevation stays as it is while sinking is the closing speed times the elevation's tangent.
    What a target that is seen too low needs of the sinking itself is not there for closing in. A
    target that is not below is closed in on at any speed.

    Args:
        elevation_rad: of the target, negative below.
        error_rad: by how much it is seen higher than wanted.
        range_m: distance to it.
        sink_m_s: how fast the vehicle may sink for it.
    """
    if elevation_rad > -_LEVEL_RAD:
        return math.inf
    needed_m_s = _BACK_PER_S * range_m * max(-error_rad, 0.0)
    left_m_s = max(sink_m_s - needed_m_s, 0.0)
    return left_m_s / math.tan(min(-elevation_rad, _STEEPEST_RAD))
