"""The truth about a moving body; known to the simulator and the score alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from follower_vision.lineofsight import rotation

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class BodyState:
    """Pose and motion in the world (north, east, down; metres, radians, seconds).

    Attributes:
        time_s: when this is true, on the simulation's clock.
        position_m: (north, east, down); the ground is the plane down = 0.
        velocity_m_s: (north, east, down).
        attitude_rad: (roll, pitch, yaw), aerospace order, body forward-right-down.
        rates_rad_s: body rates about (forward, right, down).
    """

    time_s: float
    position_m: Triple
    velocity_m_s: Triple = (0.0, 0.0, 0.0)
    attitude_rad: Triple = (0.0, 0.0, 0.0)
    rates_rad_s: Triple = (0.0, 0.0, 0.0)

    @property
    def yaw_rad(self) -> float:
        """Heading from north, clockwise seen from above."""
        return self.attitude_rad[2]

    @property
    def body_to_world(self) -> npt.NDArray[np.float64]:
        """3x3 matrix: body vectors to world vectors."""
        return rotation(*self.attitude_rad)
