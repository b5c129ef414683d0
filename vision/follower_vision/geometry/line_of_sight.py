"""Frames and angles between camera, body, level and world.

Body: forward, right, down. World: north, east, down. Level: the body turned by yaw alone, so that
it is horizontal. Euler angles are roll, pitch, yaw in the aerospace order (yaw first).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from follower_vision.geometry.camera_model import Vector

_STEEP = math.sin(math.radians(89))


def rotation(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Vector:
    """Return the 3x3 matrix that turns body vectors into world vectors."""
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array(
        [
            [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
            [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
            [-sp, sr * cp, cr * cp],
        ]
    )


def roll_pitch_yaw(w: float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the angles (rad) of a unit quaternion that turns body vectors into world vectors.

    Straight down or up only the sum or difference of roll and yaw is known: it is all yaw there,
    that it may be interpolated.
    """
    sine = min(max(2 * (w * y - z * x), -1.0), 1.0)
    pitch = math.asin(sine)
    if abs(sine) > _STEEP:
        up = math.copysign(1.0, sine)
        return 0.0, pitch, wrap_angle(2 * math.atan2(z - up * x, w + up * y))
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw


def along_camera_axes(turn: Vector) -> Vector:
    """Return what turns a camera's vectors (right, down, forward), of what turns a body's, 3x3.

    The camera points along the body's nose.
    """
    return turn[:, [1, 2, 0]]


def wrap_angle(angle_rad: float) -> float:
    """Return the same angle in [-pi, pi) rad."""
    return (angle_rad + math.pi) % (2 * math.pi) - math.pi


@dataclass(frozen=True, slots=True)
class LineOfSight:
    """A direction, rad. Azimuth: right of forward (or east of north) is positive. Elevation: up."""

    azimuth_rad: float
    elevation_rad: float

    @classmethod
    def from_vector(cls, vector: Vector) -> LineOfSight:
        """Return the direction of a vector (forward, right, down) or (north, east, down)."""
        return cls.towards(*vector.tolist())

    @classmethod
    def towards(cls, forward: float, right: float, down: float) -> LineOfSight:
        """Return the direction of what is so far forward, right and down, or north, east, down."""
        return cls(math.atan2(right, forward), math.atan2(-down, math.hypot(forward, right)))

    @property
    def vector(self) -> Vector:
        """The unit vector (forward, right, down)."""
        level = math.cos(self.elevation_rad)
        return np.array(
            [
                level * math.cos(self.azimuth_rad),
                level * math.sin(self.azimuth_rad),
                -math.sin(self.elevation_rad),
            ]
        )


@dataclass(frozen=True, slots=True)
class CameraMount:
    """How the camera is turned against the body; a camera that points down has negative pitch."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rad: float = 0.0

    @property
    def camera_to_body(self) -> Vector:
        """3x3 matrix: camera vectors (right, down, forward) to body (forward, right, down)."""
        return _camera_to_body(self.roll_rad, self.pitch_rad, self.yaw_rad)


@lru_cache(maxsize=16)
def _camera_to_body(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Vector:
    """Return the matrix of a mount, which is read-only: mounts do not change."""
    matrix = along_camera_axes(rotation(roll_rad, pitch_rad, yaw_rad))
    matrix.flags.writeable = False
    return matrix
