"""What a flight mode asks of the vehicle."""

from __future__ import annotations

from dataclasses import dataclass

from follower_sim.kinematics import Triple


@dataclass(frozen=True, slots=True)
class Demand:
    """A velocity in the world and a yaw rate.

    Attributes:
        velocity_m_s: (north, east, down).
        yaw_rate_rad_s: positive is clockwise seen from above.
    """

    velocity_m_s: Triple = (0.0, 0.0, 0.0)
    yaw_rate_rad_s: float = 0.0


STAND_STILL = Demand()
