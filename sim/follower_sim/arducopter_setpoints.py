"""How ArduCopter 4.6 reads SET_POSITION_TARGET_LOCAL_NED, as observed in SITL."""

from __future__ import annotations

import math

from follower_sim.angles import wrap
from follower_sim.kinematics import Triple
from follower_sim.position_target import (
    BODY_NED,
    BODY_OFFSET_NED,
    LOCAL_NED,
    LOCAL_OFFSET_NED,
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

_BODY = (BODY_NED, BODY_OFFSET_NED)


def arducopter_setpoint(
    target: PositionTarget, heading_rad: float, position_m: Triple
) -> Setpoint | Refusal:
    """Return what ArduCopter makes of a message that arrives at this heading and position.

    It flies frames 1, 7, 8 and 9. A position, velocity or acceleration of which any component is
    ignored is ignored wholly; if nothing is left, or a number is not finite, it stops. Where
    velocity and position are given both, the velocity carries the position along.
    """
    if target.frame not in (LOCAL_NED, LOCAL_OFFSET_NED, *_BODY):
        return Refusal()
    yaw = _yaw(target, heading_rad)
    if target.uses_all(VELOCITY_BITS):
        velocity = _in_world(target.velocity_m_s, target.frame, heading_rad)
        return Setpoint(velocity, None, *yaw) if is_finite(velocity) else STOP
    if target.uses_all(POSITION_BITS) and is_finite(target.position_m):
        goal = _goal(target, heading_rad, position_m)
        return Setpoint((0.0, 0.0, 0.0), goal, *yaw)
    return STOP


def _in_world(vector: Triple, frame: int, heading_rad: float) -> Triple:
    return turned(vector, heading_rad) if frame in _BODY else vector


def _goal(target: PositionTarget, heading_rad: float, position_m: Triple) -> Triple:
    if target.frame == LOCAL_NED:
        return target.position_m
    offset = _in_world(target.position_m, target.frame, heading_rad)
    north, east, down = (p + o for p, o in zip(position_m, offset, strict=True))
    return north, east, down


def _yaw(target: PositionTarget, heading_rad: float) -> tuple[float | None, float | None, bool]:
    """Return (yaw rate, yaw, faces the velocity); what is not finite keeps the heading."""
    if target.uses_all(YAW_BIT):
        if not math.isfinite(target.yaw_rad):
            return 0.0, None, False
        # In a body frame the angle counts from the heading of the moment, message by message.
        base = heading_rad if target.frame in _BODY else 0.0
        return None, wrap(base + target.yaw_rad), False
    if target.uses_all(YAW_RATE_BIT):
        rate = target.yaw_rate_rad_s
        return rate if math.isfinite(rate) else 0.0, None, False
    return None, None, True
