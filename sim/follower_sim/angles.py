"""Angles on the circle."""

from __future__ import annotations

import math


def wrap(angle_rad: float) -> float:
    """Return the angle in [-pi, pi)."""
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi
