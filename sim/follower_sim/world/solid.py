"""A body standing in the world, lit by the sun, ready to be drawn."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from follower_control.common.small_matrix import product
from follower_sim.bodies.mesh import Faces, Mesh
from follower_sim.kinematics import Triple
from follower_vision.geometry.camera_model import Vector

_AMBIENT = 0.62


@dataclass(frozen=True)
class Solid:
    """A mesh in world coordinates.

    Attributes:
        vertices: (V, 3) north, east, down.
        faces: (F, 4) vertex numbers.
        normals: (F, 3) outward unit vectors.
        colours: (F, 3) BGR after shading.
        layers: (F,) painting order, see `Mesh`.
        velocity_m_s: (north, east, down), for motion blur.
        shown_px: it is drawn while its apparent radius lies within these limits, so that a
            simpler body can take its place in the distance.
    """

    vertices: Vector
    faces: Faces
    normals: Vector
    colours: Vector
    layers: npt.NDArray[np.intp]
    velocity_m_s: Triple = (0.0, 0.0, 0.0)
    shown_px: tuple[float, float] = (0.7, math.inf)

    @classmethod
    def placed(
        cls,
        mesh: Mesh,
        position_m: npt.ArrayLike,
        body_to_world: Vector,
        sun: Vector | None,
        velocity_m_s: Triple = (0.0, 0.0, 0.0),
    ) -> Solid:
        """Put a mesh into the world.

        Args:
            mesh: in body axes.
            position_m: (3,) of its origin.
            body_to_world: 3x3 rotation.
            sun: (3,) unit vector from the ground to the sun; None leaves the colours as they are,
                where only the outline matters.
            velocity_m_s: of the body.
        """
        vertices = product(body_to_world, mesh.vertices.T).T + np.asarray(position_m)
        normals = product(body_to_world, mesh.normals.T).T
        colours = mesh.colours if sun is None else _lit(mesh.colours, normals, sun)
        return cls(vertices, mesh.faces, normals, colours, mesh.layers, velocity_m_s)

    @cached_property
    def centre(self) -> Vector:
        """(3,) middle of its bounding box."""
        return np.asarray((self.vertices.min(axis=0) + self.vertices.max(axis=0)) / 2)

    @cached_property
    def radius_m(self) -> float:
        """Of the sphere about the centre that holds everything, metres."""
        return float(np.linalg.norm(self.vertices - self.centre, axis=1).max())

    @cached_property
    def face_centres(self) -> Vector:
        """(F, 3) mean of each face's corners."""
        return np.asarray(self.vertices[self.faces].mean(axis=1))

    def shadow(self, sun: Vector) -> Vector:
        """Return the convex outline, (N, 2) north and east, of the shadow on the ground."""
        reach = self.vertices[:, 2] / sun[2]
        on_ground = self.vertices[:, :2] - sun[:2] * reach[:, None]
        return np.asarray(cv2.convexHull(on_ground.astype(np.float32)).reshape(-1, 2), np.float64)


def _lit(colours: Vector, normals: Vector, sun: Vector) -> Vector:
    """Return the colours of faces in the sun's light and the sky's."""
    light = _AMBIENT + (1.08 - _AMBIENT) * np.maximum(0, normals @ sun)
    light -= 0.1 * np.maximum(0, normals[:, 2])
    return np.asarray(np.clip(colours * light[:, None], 0, 255))
