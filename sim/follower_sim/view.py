"""Where a camera is and how it looks: world points into camera axes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from follower_control.common.small_matrix import length, product
from follower_sim.kinematics import BodyState, Triple
from follower_vision.geometry.camera_model import Vector
from follower_vision.geometry.line_of_sight import CameraMount

_EAST = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, slots=True)
class CameraView:
    """A camera's pose at one instant.

    Attributes:
        position_m: (3,) north, east, down.
        world_to_camera: 3x3, world vectors to (right, down, forward).
    """

    position_m: Vector
    world_to_camera: Vector

    @classmethod
    def of(cls, body: BodyState, mount: CameraMount, after_s: float = 0.0) -> CameraView:
        """Return the view of a camera at the body's origin, `after_s` later at its present rates.

        Args:
            body: pose and motion of the vehicle.
            mount: how the camera is turned against the body.
            after_s: a fraction of an exposure, positive or negative.
        """
        position, turn = np.array(body.position_m), body.body_to_world
        if after_s != 0:
            position = position + np.array(body.velocity_m_s) * after_s
            turned = cv2.Rodrigues(np.array(body.rates_rad_s) * after_s)[0]
            turn = product(turn, np.asarray(turned, np.float64))
        camera_to_world = product(turn, mount.camera_to_body)
        return cls(position, np.asarray(camera_to_world.T))

    @property
    def eye_m(self) -> Triple:
        """The position as plain floats, metres NED."""
        north, east, down = self.position_m.tolist()
        return north, east, down

    def to_camera(self, points: npt.ArrayLike) -> Vector:
        """Turn world points, (N, 3), into camera axes."""
        relative = np.asarray(points, np.float64).reshape(-1, 3) - self.position_m
        return product(self.world_to_camera, relative.T).T

    @classmethod
    def towards(cls, position_m: Vector, place_m: Vector) -> CameraView:
        """Return the view of a camera that looks at a place, (3,), with its right side level."""
        forward = np.asarray(place_m - position_m, np.float64)
        forward = forward / length(forward)
        level = math.hypot(forward[0], forward[1])
        right = np.array([-forward[1] / level, forward[0] / level, 0.0]) if level > 0 else _EAST
        return cls(position_m, np.array([right, np.cross(forward, right), forward]))
