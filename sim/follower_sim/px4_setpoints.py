"""How PX4 1.18 reads SET_POSITION_TARGET_LOCAL_NED, as observed in SITL."""

from __future__ import annotations

import math

from follower_sim.angles import wrap
from follower_sim.position_target import (
    BODY_NED,
    LOCAL_NED,
    POSITION_BITS,
    STOP,
    VELOCITY_BITS,
    YAW_BIT,
    YAW_RATE_BIT,
    PositionTarget,
    Refusal,
    Setpoint,
    is_finite,
    turned,
)

_MESSAGE = "SET_POSITION_TARGET_LOCAL_NED"


def px4_setpoint(target: PositionTarget, heading_rad: float) -> Setpoint | Refusal:
    """Return what PX4 makes of a message that arrives at this heading.

    It flies frames 1 and 8 alone. Velocity needs all three components; a body frame turns them by
    the heading, and nothing else: positions and headings stay those of the world.
    """
    if target.frame not in (LOCAL_NED, BODY_NED):
        return Refusal(f"{_MESSAGE} coordinate frame {target.frame} unsupported")
    if not _is_whole(target):
        return Refusal(f"{_MESSAGE} invalid")
    velocity = target.velocity_m_s if target.uses_all(VELOCITY_BITS) else (0.0, 0.0, 0.0)
    if not is_finite(velocity):
        return STOP
    if target.frame == BODY_NED:
        velocity = turned(velocity, heading_rad)
    return Setpoint(velocity, _position(target), *_yaw(target))


def _is_whole(target: PositionTarget) -> bool:
    """Whether position and velocity are each there wholly or not at all, and one of them is."""
    position, velocity = target.uses_all(POSITION_BITS), target.uses_all(VELOCITY_BITS)
    halves = (not position and target.uses_any(POSITION_BITS)) or (
        not velocity and target.uses_any(VELOCITY_BITS)
    )
    return (position or velocity) and not halves


def _position(target: PositionTarget) -> tuple[float, float, float] | None:
    usable = target.uses_all(POSITION_BITS) and is_finite(target.position_m)
    return target.position_m if usable else None


def _yaw(target: PositionTarget) -> tuple[float | None, float | None]:
    """Return (yaw rate, yaw); what is not finite counts as not given."""
    if target.uses_all(YAW_BIT) and math.isfinite(target.yaw_rad):
        return None, wrap(target.yaw_rad)
    if target.uses_all(YAW_RATE_BIT) and math.isfinite(target.yaw_rate_rad_s):
        return target.yaw_rate_rad_s, None
    return 0.0, None
