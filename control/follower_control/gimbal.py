"""What a gimbal is told, and where its camera looks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from follower_control.vehicle import Attitude, GimbalState
from follower_vision.camera import Vector
from follower_vision.lineofsight import CAMERA_TO_BODY, rotation


@dataclass(frozen=True, slots=True)
class GimbalRates:
    """How fast a gimbal's camera is to turn, against the world.

    Attributes:
        pitch_rad_s: up is positive.
        yaw_rad_s: to the right is positive.
    """

    pitch_rad_s: float = 0.0
    yaw_rad_s: float = 0.0


STILL = GimbalRates()
"""Keep looking where it looks."""


def camera_to_world(gimbal: GimbalState, vehicle: Attitude) -> Vector:
    """Return the 3x3 matrix from camera axes (right, down, forward) to the world's.

    Args:
        gimbal: how it holds the camera.
        vehicle: its attitude at the same time.
    """
    camera = gimbal.attitude
    if not gimbal.is_level:
        body = rotation(vehicle.roll_rad, vehicle.pitch_rad, vehicle.yaw_rad)
        turn = rotation(camera.roll_rad, camera.pitch_rad, camera.yaw_rad)
        return np.asarray(body @ turn @ CAMERA_TO_BODY)
    yaw = camera.yaw_rad + (0.0 if gimbal.from_north else vehicle.yaw_rad)
    return np.asarray(rotation(camera.roll_rad, camera.pitch_rad, yaw) @ CAMERA_TO_BODY)
