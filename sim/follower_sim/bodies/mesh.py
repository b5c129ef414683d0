"""Low-poly bodies: vertices, flat faces and colours, and the convex blocks they are built of.

Blocks are given in forward, right, up; meshes are kept in forward, right, down.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from follower_vision.geometry.camera_model import Vector

Colour: TypeAlias = tuple[int, int, int]
"""Blue, green, red, 0 to 255."""

Faces: TypeAlias = npt.NDArray[np.intp]

_DOWN = np.array([1.0, 1.0, -1.0])


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
        """Return the mesh shifted in its own axes, metres."""
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
        """How far its farthest vertex is from its origin, metres."""
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


Point = tuple[float, float, float]
Outline = Sequence[Point] | Vector


def convex(
    polygons: Sequence[tuple[Outline, Colour]], layer: int = 0, centre: Point | None = None
) -> Mesh:
    """Make a mesh of polygons (forward, right, up), turned to face away from `centre`.

    Without a centre it is the mean of all corners, as fits a convex body.
    """
    corners = [np.asarray(points, np.float64) * _DOWN for points, _ in polygons]
    middle = np.vstack(corners).mean(axis=0) if centre is None else np.array(centre) * _DOWN
    colours = [colour for _, colour in polygons]
    turned = [_turned_away(points, middle) for points in corners]
    return Mesh.of_polygons(list(zip(turned, colours, strict=True)), layer)


def _turned_away(points: Vector, centre: Vector) -> Vector:
    """Order the corners anticlockwise as seen from outside."""
    (a, b, c), (d, e, f) = points[1:3] - points[0]
    # Their cross product, along the way out; np.cross takes many times as long for so few.
    x, y, z = points.mean(axis=0) - centre
    outwards = (b * f - c * e) * x + (c * d - a * f) * y + (a * e - b * d) * z
    return points if outwards >= 0 else points[::-1]


def prism(
    lower: Outline, upper: Outline, side: Colour, top: Colour | None = None, layer: int = 0
) -> Mesh:
    """Make the convex body between two outlines with equally many corners."""
    count = len(lower)
    sides = [
        ([lower[i], lower[(i + 1) % count], upper[(i + 1) % count], upper[i]], side)
        for i in range(count)
    ]
    floor = [(part, side) for part in _quads(lower)]
    roof = [(part, side if top is None else top) for part in _quads(upper)]
    return convex([*sides, *floor, *roof], layer)


def _quads(outline: Outline) -> list[list[Point]]:
    """Cut a convex outline into quadrilaterals, and a triangle if one is left over."""
    corners = [tuple(map(float, point)) for point in outline]
    starts = range(1, len(corners) - 1, 2)
    return [[corners[0], *corners[i : i + 3]] for i in starts]  # type: ignore[list-item]


def rectangle(length: float, width: float, up: float, at: tuple[float, float] = (0, 0)) -> Outline:
    """Return a level rectangle about (forward, right) = `at`."""
    f, r = length / 2, width / 2
    return [(at[0] + a, at[1] + b, up) for a, b in ((f, r), (f, -r), (-f, -r), (-f, r))]


def ring(sides: int, radius: float, up: float, at: tuple[float, float] = (0, 0)) -> Outline:
    """Return a level regular polygon about (forward, right) = `at`."""
    angles = [2 * math.pi * (i + 0.5) / sides for i in range(sides)]
    return [(at[0] + radius * math.cos(a), at[1] + radius * math.sin(a), up) for a in angles]


def box(
    size: Point,
    colour: Colour,
    at: Point = (0, 0, 0),
    top: Colour | None = None,
    layer: int = 0,
) -> Mesh:
    """Make a box of (length, width, height) whose floor's middle is `at`."""
    length, width, height = size
    lower = rectangle(length, width, at[2], at[:2])
    upper = rectangle(length, width, at[2] + height, at[:2])
    return prism(lower, upper, colour, top, layer)


def disc(radius: float, at: Point, colour: Colour, sides: int = 8, layer: int = 0) -> Mesh:
    """Make a level disc that faces up, seen from above only; metres."""
    parts = _quads(ring(sides, radius, at[2], at[:2]))
    return convex([(part, colour) for part in parts], layer, centre=(at[0], at[1], at[2] - 1))


def wheel(radius: float, at: Point, side: float, layer: int = 0) -> Mesh:
    """Make a wheel's outer face with its hub, facing right (`side` 1) or left (-1)."""
    away = (at[0], at[1] - side, at[2])
    tyre = [(at[0] + f, at[1], at[2] + r) for f, r, _ in ring(10, radius, 0)]
    hub = [(at[0] + f, at[1], at[2] + r) for f, r, _ in ring(6, radius * 0.55, 0)]
    return Mesh.joined(
        [
            convex([(part, (32, 30, 30)) for part in _quads(tyre)], layer, away),
            convex([(part, (168, 165, 160)) for part in _quads(hub)], layer + 1, away),
        ]
    )


def panel(
    face: Outline,
    across: tuple[float, float],
    along: tuple[float, float],
    colour: Colour,
    away_from: Point,
    layer: int,
) -> Mesh:
    """Make a part of a four-cornered face (a window in a wall, say).

    Args:
        face: the four corners, in order.
        across: from and to, as shares of the way from the first to the second corner.
        along: from and to, as shares of the way from the first to the fourth corner.
        colour: of the panel.
        away_from: a point (forward, right, up) behind it.
        layer: to be painted after that of the face.
    """
    a, b, c, d = (np.asarray(p, np.float64) for p in face)

    def point(u: float, v: float) -> Vector:
        return np.asarray((1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c))

    (u0, u1), (v0, v1) = across, along
    corners = np.array([point(u0, v0), point(u1, v0), point(u1, v1), point(u0, v1)])
    return convex([(corners, colour)], layer, away_from)


def ball(radius: float, centre: Point, colour: Colour, roughness: Vector | None = None) -> Mesh:
    """Make an icosahedron; `roughness`, shape (12,), multiplies the distance of its corners."""
    corners, faces = _icosahedron()
    stretch = np.ones(12) if roughness is None else roughness
    points = corners * (radius * stretch[:, None]) + centre
    return convex([(points[list(face)], colour) for face in faces], 0, centre)


@cache
def _icosahedron() -> tuple[Vector, list[tuple[int, int, int]]]:
    """Return the corners, (12, 3), of one with a radius of 1, and the corners of each face."""
    g = (1 + math.sqrt(5)) / 2
    corners = np.array(
        [p for a in (1, -1) for b in (g, -g) for p in ((0, a, b), (a, b, 0), (b, 0, a))]
    ) / math.hypot(1, g)
    near = np.linalg.norm(corners[:, None] - corners[None], axis=2) < 1.2
    faces = [
        (i, j, k)
        for i in range(12)
        for j in range(i)
        for k in range(j)
        if near[i, j] and near[j, k] and near[i, k]
    ]
    return corners, faces
