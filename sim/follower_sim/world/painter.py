"""Draws bodies into an image by painter's algorithm: far ones first."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
import numpy.typing as npt

from follower_sim.bodies.mesh import Faces
from follower_sim.kinematics import Triple, mix
from follower_sim.view import CameraView
from follower_sim.world.solid import Solid
from follower_sim.world.weather import Fog
from follower_vision.geometry.camera_model import CameraModel, Vector
from follower_vision.images.frame import Image

NEAR_M = 0.15
_WIDEST_GUARD = 3.0

_SHIFT = 4
_REACH_PX = 2
"""So far beyond its outline a polygon surely colours nothing."""


class LensProjection:
    """Projects points in camera axes and clips polygons to what the lens can image.

    The distortion polynomial of a real lens folds back far outside the image. Therefore nothing
    is projected beyond a guard pyramid, somewhat wider than the view, where it still grows.
    """

    def __init__(self, camera: CameraModel) -> None:
        self.camera = camera
        corners = np.array([[0, 0], [camera.width, 0], [0, camera.height],
                            [camera.width, camera.height]], np.float64)  # fmt: skip
        rays = camera.rays(corners)
        self._extent = np.abs(rays[:, :2] / rays[:, 2:]).max(axis=0)
        self._extent *= _guard_factor(camera, float(np.hypot(*self._extent)))
        self._borders = _borders(camera)

    def pixels(self, points: Vector) -> Vector:
        """Project points in camera axes, (N, 3) with forward > 0, to pixels, (N, 2)."""
        return self.camera.pixels(points)

    def outside(self, points: Vector) -> npt.NDArray[np.bool_]:
        """Return for each point, (..., 3), which of the five planes it is behind, (..., 5)."""
        return np.stack(self._heights(points), axis=-1) < 0

    def holds(self, centre: Vector, radius_m: float) -> bool:
        """Whether a ball, its middle (3,) in camera axes, surely lies wholly in the image.

        Of a lens with tangential distortion nothing is sure.
        """
        if self._borders is None:
            return False
        x, y, z = centre.tolist()
        left, right, top, bottom = self._borders
        inside = bool(z - radius_m > NEAR_M)
        for slope, across in ((left, x), (right, -x), (top, y), (bottom, -y)):
            inside = inside and z * slope + across > radius_m * math.hypot(1.0, slope)
        return inside

    def _heights(self, points: Vector) -> list[Vector]:
        """Return the distances, up to a factor, inward from near, left, right, top, bottom."""
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        across, down = z * self._extent[0], z * self._extent[1]
        return [z - NEAR_M, across + x, across - x, down + y, down - y]

    def touches(self, centres: Vector, radii: Vector) -> npt.NDArray[np.bool_]:
        """Return which spheres, centres (N, 3) in camera axes, reach into the guard pyramid."""
        slopes = np.hypot(1, np.array([0, *np.repeat(self._extent, 2)]))
        heights = np.stack(self._heights(centres), axis=-1)
        return np.asarray(np.all(heights > -radii[:, None] * slopes, axis=-1))

    def clipped(self, polygon: Vector) -> Vector:
        """Cut a polygon, (N, 3) in camera axes, to the guard pyramid (Sutherland-Hodgman)."""
        corners: list[Triple] = [(x, y, z) for x, y, z in polygon.tolist()]
        wide, tall = self._extent.tolist()
        for plane in range(5):
            heights = [_height(corner, plane, wide, tall) for corner in corners]
            if len(corners) >= 3 and min(heights) < 0:
                corners = _cut(corners, heights)
        return np.array(corners).reshape(-1, 3)


def _height(corner: Triple, plane: int, wide: float, tall: float) -> float:
    """Return the distance, up to a factor, inward from near, left, right, top or bottom."""
    x, y, z = corner
    return (z - NEAR_M, z * wide + x, z * wide - x, z * tall + y, z * tall - y)[plane]


def _cut(polygon: list[Triple], heights: list[float]) -> list[Triple]:
    """Keep the part of a polygon whose heights over a plane are not negative; plain floats."""
    kept = []
    for i, (corner, height) in enumerate(zip(polygon, heights, strict=True)):
        before, height_before = polygon[i - 1], heights[i - 1]
        if (height < 0) != (height_before < 0):
            share = height_before / (height_before - height)
            kept.append(mix(before, corner, share))
        if height >= 0:
            kept.append(corner)
    return kept


def _guard_factor(camera: CameraModel, corner: float) -> float:
    """Return how much wider than the view the lens still images farther points farther out."""
    if not any(camera.distortion):
        return _WIDEST_GUARD
    k1, k2, _, _, k3 = camera.distortion
    factor = np.linspace(1, _WIDEST_GUARD, 201)
    r2 = (factor * corner) ** 2
    slope = 1 + r2 * (3 * k1 + r2 * (5 * k2 + r2 * 7 * k3))
    folded = np.flatnonzero(slope <= 0.05)
    last = folded[0] - 1 if len(folded) else len(factor) - 1
    return max(1.01, float(factor[max(0, last)]))


def _borders(camera: CameraModel) -> tuple[float, float, float, float] | None:
    """Return how far left, right, up and down of the axis, per depth, all is in the image.

    None if tangential distortion makes that too intricate.
    """
    k1, k2, p1, p2, k3 = camera.distortion
    if p1 or p2:
        return None
    right, bottom = camera.width - camera.cx, camera.height - camera.cy
    left, right = camera.cx / camera.fx, right / camera.fx
    top, bottom = camera.cy / camera.fy, bottom / camera.fy
    r2 = np.linspace(0, max(left, right) ** 2 + max(top, bottom) ** 2, 201)
    most = max(1.0, float((1 + r2 * (k1 + r2 * (k2 + r2 * k3))).max()))
    return left / most, right / most, top / most, bottom / most


FixedPoints = npt.NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class SolidBatch:
    """Many solids in common arrays, so that a frame costs few numpy calls.

    Attributes:
        vertices: (V, 3).
        faces: (F, 4).
        normals, face_centres, colours: (F, 3).
        layers, owners: (F,) layer, and number of the solid that the face belongs to.
        centres, radii_m: (S, 3), (S,) of the solids.
        velocities_m_s: (S, 3) of the solids.
        shown_px: (S, 2) the apparent radii between which each is drawn.
    """

    vertices: Vector
    faces: Faces
    normals: Vector
    face_centres: Vector
    colours: Vector
    layers: npt.NDArray[np.intp]
    owners: npt.NDArray[np.intp]
    centres: Vector
    radii_m: Vector
    velocities_m_s: Vector
    shown_px: Vector

    @classmethod
    def of(cls, solids: Sequence[Solid]) -> Self:
        """Put solids together."""
        starts = np.cumsum([0, *(len(s.vertices) for s in solids)])
        return cls(
            np.vstack([np.empty((0, 3)), *(s.vertices for s in solids)]),
            np.vstack([np.empty((0, 4), np.intp),
                       *(s.faces + n for s, n in zip(solids, starts, strict=False))]),
            np.vstack([np.empty((0, 3)), *(s.normals for s in solids)]),
            np.vstack([np.empty((0, 3)), *(s.face_centres for s in solids)]),
            np.vstack([np.empty((0, 3)), *(s.colours for s in solids)]),
            np.concatenate([np.empty(0, np.intp), *(s.layers for s in solids)]),
            np.repeat(np.arange(len(solids)), [len(s.faces) for s in solids]),
            np.array([s.centre for s in solids]).reshape(-1, 3),
            np.array([s.radius_m for s in solids]),
            np.array([s.velocity_m_s for s in solids]).reshape(-1, 3),
            np.array([s.shown_px for s in solids]).reshape(-1, 2),
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class VisibleFaces:
    """The faces that a view shows, in painting order.

    Attributes:
        corners: (F, 4, 3) in the world.
        velocities_m_s: (F, 3) of the solids that they belong to.
        colours: of each face.
    """

    corners: Vector
    velocities_m_s: Vector
    colours: list[list[float]]


class SolidPainter:
    """Draws batches of solids, and the shadows of moving ones, through a lens.

    OpenCV's anti-aliased polygons reach 0.76 px (mean) beyond their outline on every side: that
    closes the seams between faces, and bodies look so much larger, without being shifted.
    """

    def __init__(self, lens: LensProjection, fog: Fog | None = None) -> None:
        self._lens = lens
        self._fog = fog
        self._focal_px = max(lens.camera.fx, lens.camera.fy)

    def select(self, batches: Sequence[SolidBatch], view: CameraView) -> VisibleFaces:
        """Choose the faces that look towards the camera and sort them, the farthest first."""
        parts = [self._chosen(batch, view) for batch in batches]
        corners, velocities, colours, keys = (np.concatenate(p) for p in zip(*parts, strict=True))
        order = np.lexsort(keys.T)
        return VisibleFaces(corners[order], velocities[order], colours[order].tolist())

    def _chosen(self, batch: SolidBatch, view: CameraView) -> tuple[Vector, Vector, Vector, Vector]:
        """Return corners, velocities, colours and sorting keys of one batch's visible faces."""
        near, distances = self._near_solids(batch, view)
        chosen = np.flatnonzero(near[batch.owners])
        away = batch.face_centres[chosen] - view.position_m
        towards = np.einsum("ij,ij->i", batch.normals[chosen], away) < 0
        chosen, away = chosen[towards], away[towards]
        owners = batch.owners[chosen]
        depth = np.linalg.norm(away, axis=1)
        keys = np.column_stack([-depth, batch.layers[chosen], owners, -distances[owners]])
        corners, colours = batch.vertices[batch.faces[chosen]], batch.colours[chosen]
        if self._fog is not None:
            colours = self._fog.over(colours, depth)
        return corners, batch.velocities_m_s[owners], colours, keys

    def _near_solids(
        self, batch: SolidBatch, view: CameraView
    ) -> tuple[npt.NDArray[np.bool_], Vector]:
        """Return which solids are in view and drawn at their distance, and how far each is."""
        centres = view.to_camera(batch.centres)
        distances = np.asarray(np.linalg.norm(centres, axis=1))
        apparent_px = batch.radii_m * self._focal_px / np.maximum(distances, 1e-9)
        shown = (apparent_px > batch.shown_px[:, 0]) & (apparent_px <= batch.shown_px[:, 1])
        return shown & self._lens.touches(centres, batch.radii_m), distances

    def paint(
        self, image: Image, selection: VisibleFaces, view: CameraView, after_s: float = 0.0
    ) -> None:
        """Draw the faces as they stand `after_s` after their selection."""
        corners = selection.corners + selection.velocities_m_s[:, None] * after_s
        for number, polygon in self.polygons(corners, view, in_image_only=True):
            colour = selection.colours[number]
            cv2.fillConvexPoly(image, polygon, colour, cv2.LINE_AA, _SHIFT)

    def polygons(
        self, corners: Vector, view: CameraView, in_image_only: bool = False
    ) -> Iterator[tuple[int, FixedPoints]]:
        """Yield the number and the image polygon, in OpenCV's fixed point, of each face in view.

        Args:
            corners: (F, 4, 3) in the world.
            view: of the camera.
            in_image_only: leave out what colours nothing in the image, only beside it.
        """
        points = view.to_camera(corners).reshape(-1, 4, 3)
        outside = self._lens.outside(points)
        seen = np.flatnonzero(~np.any(np.all(outside, axis=1), axis=1))
        points = points[seen]
        cut = np.any(outside[seen].reshape(-1, 4 * outside.shape[-1]), axis=1)
        fixed = self._fixed(np.where(cut[:, None, None], (0.0, 0.0, 1.0), points))
        shown = cut | self.in_image(fixed) if in_image_only else np.ones_like(cut)
        for place in np.flatnonzero(shown).tolist():
            polygon = self._cut_polygon(points[place]) if cut[place] else fixed[place]
            if polygon is not None:
                yield int(seen[place]), polygon

    def in_image(self, polygons: FixedPoints) -> npt.NDArray[np.bool_]:
        """Return which polygons, (F, corners, 2) in fixed point, may reach into the image."""
        most = np.array([self._lens.camera.width + _REACH_PX, self._lens.camera.height + _REACH_PX])
        after, before = polygons.max(axis=1), polygons.min(axis=1)
        inside = (after >= -_REACH_PX << _SHIFT) & (before <= most << _SHIFT)
        return np.asarray(inside.all(axis=1))

    def _fixed(self, corners: Vector) -> FixedPoints:
        pixels = self._lens.pixels(corners.reshape(-1, 3)).reshape(*corners.shape[:-1], 2)
        return np.asarray(np.round((pixels - 0.5) * (1 << _SHIFT)), np.int32)

    def _cut_polygon(self, corners: Vector) -> FixedPoints | None:
        polygon = self._lens.clipped(corners)
        return self._fixed(polygon) if len(polygon) >= 3 else None

    def shade(self, image: Image, outline: Vector, view: CameraView, darkness: float) -> None:
        """Darken the ground within a convex outline, (N, 2) north and east, with soft edges."""
        ground = np.column_stack([outline, np.zeros(len(outline))])
        polygon = self._lens.clipped(view.to_camera(ground))
        if len(polygon) < 3:
            return
        fixed = self._fixed(polygon)
        area = _inflated(cv2.boundingRect((fixed / (1 << _SHIFT)).astype(np.int32)), image)
        if area is None:
            return
        part = image[area]
        light = np.full(part.shape[:2], 255, np.uint8)
        offset = np.array([area[1].start << _SHIFT, area[0].start << _SHIFT], np.int32)
        shade = round(255 * (1 - darkness))
        cv2.fillConvexPoly(light, fixed - offset, (shade,), cv2.LINE_AA, _SHIFT)
        soft = cv2.merge([cv2.blur(light, (5, 5))] * 3)
        cv2.multiply(part, soft, dst=part, scale=1 / 255)


def _inflated(box: Sequence[int], image: Image) -> tuple[slice, slice] | None:
    """Return the slices of a box and 3 px about it, or None outside the image."""
    x, y, width, height = box
    rows = slice(max(0, y - 3), min(image.shape[0], y + height + 3))
    columns = slice(max(0, x - 3), min(image.shape[1], x + width + 3))
    empty = rows.start >= rows.stop or columns.start >= columns.stop
    return None if empty else (rows, columns)
