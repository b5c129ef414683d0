"""What is asked of the vehicle."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class VelocitySetpoint:
    """A velocity in the heading frame (level; forward along the nose) and a yaw rate.

    This is MAV_FRAME_BODY_NED as PX4 and ArduPilot fly it: roll and pitch do not tilt it.

    Attributes:
        forward_m_s: along the heading, horizontally.
        right_m_s: to the right of the heading, horizontally.
        down_m_s: positive is descent.
        yaw_rate_rad_s: positive is clockwise seen from above.
    """

    forward_m_s: float = 0.0
    right_m_s: float = 0.0
    down_m_s: float = 0.0
    yaw_rate_rad_s: float = 0.0

    @property
    def is_finite(self) -> bool:
        """Whether all four numbers are finite."""
        return all(map(math.isfinite, self.values))

    @property
    def values(self) -> tuple[float, float, float, float]:
        """(forward, right, down, yaw rate) in m/s and rad/s."""
        return self.forward_m_s, self.right_m_s, self.down_m_s, self.yaw_rate_rad_s


HOLD = VelocitySetpoint()
"""Stand still, keep the heading."""
