"""SET_POSITION_TARGET_LOCAL_NED: what it carries and what comes of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from follower_sim.kinematics import Triple

POSITION_BITS = 0x007
VELOCITY_BITS = 0x038
ACCELERATION_BITS = 0x1C0
YAW_BIT = 0x400
YAW_RATE_BIT = 0x800

LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED = 1, 7, 8, 9


@dataclass(frozen=True, slots=True)
class PositionTarget:
    """The message's fields, as they came: bits set in `type_mask` are to be ignored."""

    frame: int
    type_mask: int
    position_m: Triple
    velocity_m_s: Triple
    yaw_rad: float
    yaw_rate_rad_s: float

    def uses_any(self, bits: int) -> bool:
        """Whether not all of these fields are ignored."""
        return self.type_mask & bits != bits

    def uses_all(self, bits: int) -> bool:
        """Whether none of these fields is ignored."""
        return self.type_mask & bits == 0


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What the autopilot flies from now on; world axes, north-east-down.

    Attributes:
        velocity_m_s: the velocity, or how fast the position itself moves.
        position_m: in the local frame; None flies the velocity alone.
        yaw_rate_rad_s: positive is clockwise seen from above; None leaves that to the others.
        yaw_rad: the heading to turn to, from north.
        faces_velocity: the nose turns into the velocity.
    """

    velocity_m_s: Triple
    position_m: Triple | None = None
    yaw_rate_rad_s: float | None = None
    yaw_rad: float | None = None
    faces_velocity: bool = False


STOP = Setpoint((0.0, 0.0, 0.0), yaw_rate_rad_s=0.0)


@dataclass(frozen=True, slots=True)
class Refusal:
    """A message that changes nothing; `text` is what the autopilot complains, "" if silent."""

    text: str = ""


def turned(vector: Triple, yaw_rad: float) -> Triple:
    """Return a heading-frame vector (forward, right, down) in the world."""
    cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
    forward, right, down = vector
    return forward * cos_yaw - right * sin_yaw, forward * sin_yaw + right * cos_yaw, down


def is_finite(vector: Triple) -> bool:
    """Whether all three numbers are finite."""
    return all(map(math.isfinite, vector))
