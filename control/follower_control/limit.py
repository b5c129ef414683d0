"""The names of the envelope's limits."""

from __future__ import annotations

from enum import StrEnum


class Limit(StrEnum):
    """What kept a setpoint from being allowed as asked."""

    NOT_FINITE = "not finite"
    SPEED = "speed"
    DOUBT = "doubtful estimate"
    CLIMB = "climb speed"
    DESCENT = "descent speed"
    YAW_RATE = "yaw rate"
    MIN_HEIGHT = "minimum height"
    MIN_CLEARANCE = "minimum clearance"
    CEILING = "ceiling"
    HEIGHT_UNKNOWN = "height unknown"
    FENCE = "fence"
    POSITION_UNKNOWN = "position unknown"
    TARGET_NEAR = "minimum distance"
    RANGE_UNKNOWN = "range unknown"
    ACCELERATION = "acceleration"
    YAW_ACCELERATION = "yaw acceleration"
