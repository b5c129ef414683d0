"""Low-poly bodies: vertices, flat faces and their colours."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from follower_vision.camera import Vector

Colour: TypeAlias = tuple[int, int, int]
"""Blue, green, red, 0 to 255."""

Faces: TypeAlias = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Mesh:
    """A body in its own axes (forward, right, down), origin where it touches the ground.

    Attributes:
        vertices: (V, 3) metres.
        faces: (F, 4) vertex numbers, anticlockwise seen from outside; a triangle repeats its last.
        colours: (F, 3) BGR, 0 to 255, before shading.
        layers: (F,) faces of a higher layer are painted over those of a lower one.
    """

    vertices: Vector
    faces: Faces
    colours: Vector
    layers: npt.NDArray[np.intp]

    @classmethod
    def of_polygons(cls, polygons: Iterable[tuple[npt.ArrayLike, Colour]], layer: int = 0) -> Mesh:
        """Make a mesh of separate polygons of 3 or 4 corners each, (corners, 3) metres."""
        vertices, faces, colours, count = [], [], [], 0
        for corners, colour in polygons:
            points = np.asarray(corners, np.float64)
            faces.append([count + min(i, len(points) - 1) for i in range(4)])
            vertices.append(points)
            colours.append(colour)
            count += len(points)
        return cls(
            np.vstack(vertices),
            np.array(faces, np.intp),
            np.array(colours, np.float64),
            np.full(len(faces), layer, np.intp),
        )

    @classmethod
    def joined(cls, meshes: Sequence[Mesh]) -> Mesh:
        """Put several meshes together."""
        starts = np.cumsum([0, *(len(m.vertices) for m in meshes[:-1])])
        return cls(
            np.vstack([m.vertices for m in meshes]),
            np.vstack([m.faces + start for m, start in zip(meshes, starts, strict=True)]),
            np.vstack([m.colours for m in meshes]),
            np.concatenate([m.layers for m in meshes]),
        )

    def moved(self, forward: float = 0.0, right: float = 0.0, down: float = 0.0) -> Mesh:
        """Return the mesh shifted in its own axes."""
        return replace(self, vertices=self.vertices + np.array([forward, right, down]))

    def turned(self, rotation: Vector) -> Mesh:
        """Return the mesh turned about its origin by a 3x3 matrix."""
        return replace(self, vertices=self.vertices @ rotation.T)

    @cached_property
    def corners(self) -> Vector:
        """The vertices, (C, 3), each place once: faces that meet have their own."""
        return np.asarray(np.unique(self.vertices, axis=0))

    @cached_property
    def reach_m(self) -> float:
        """How far its farthest vertex is from its origin."""
        return float(np.sqrt((self.vertices**2).sum(axis=1).max()))

    @cached_property
    def normals(self) -> Vector:
        """(F, 3) outward unit vectors."""
        return face_normals(self.vertices, self.faces)


def face_normals(vertices: Vector, faces: Faces) -> Vector:
    """Return the outward unit normals, (F, 3), of flat faces."""
    a, b, c, d = (vertices[faces[:, i]] for i in range(4))
    normal = np.cross(c - a, d - b)
    triangle = np.cross(b - a, c - a)
    normal = np.where((faces[:, 2] == faces[:, 3])[:, None], triangle, normal)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.asarray(normal / np.maximum(length, 1e-12))
