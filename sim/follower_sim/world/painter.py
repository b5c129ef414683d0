"""Draws bodies into an image by painter's algorithm: far ones first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
import numpy.typing as npt

from follower_sim.lens import Lens
from follower_sim.mesh import Faces
from follower_sim.solid import Solid
from follower_sim.view import View
from follower_vision.camera import Vector
from follower_vision.frame import Image

_SHIFT = 4
_REACH_PX = 2
"""So far beyond its outline a polygon surely colours nothing."""

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
class Selection:
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

    def __init__(self, lens: Lens) -> None:
        self._lens = lens
        self._focal_px = max(lens.camera.fx, lens.camera.fy)

    def select(self, batches: Sequence[SolidBatch], view: View) -> Selection:
        """Choose the faces that look towards the camera and sort them, the farthest first."""
        parts = [self._chosen(batch, view) for batch in batches]
        corners, velocities, colours, keys = (np.concatenate(p) for p in zip(*parts, strict=True))
        order = np.lexsort(keys.T)
        return Selection(corners[order], velocities[order], colours[order].tolist())

    def _chosen(self, batch: SolidBatch, view: View) -> tuple[Vector, Vector, Vector, Vector]:
        """Return corners, velocities, colours and sorting keys of one batch's visible faces."""
        near, distances = self._near_solids(batch, view)
        chosen = np.flatnonzero(near[batch.owners])
        sight = batch.face_centres[chosen] - view.position_m
        towards = np.einsum("ij,ij->i", batch.normals[chosen], sight) < 0
        chosen, sight = chosen[towards], sight[towards]
        owners = batch.owners[chosen]
        depth = np.linalg.norm(sight, axis=1)
        keys = np.column_stack([-depth, batch.layers[chosen], owners, -distances[owners]])
        corners = batch.vertices[batch.faces[chosen]]
        return corners, batch.velocities_m_s[owners], batch.colours[chosen], keys

    def _near_solids(self, batch: SolidBatch, view: View) -> tuple[npt.NDArray[np.bool_], Vector]:
        """Return which solids are in view and drawn at their distance, and how far each is."""
        centres = view.to_camera(batch.centres)
        distances = np.asarray(np.linalg.norm(centres, axis=1))
        apparent_px = batch.radii_m * self._focal_px / np.maximum(distances, 1e-9)
        shown = (apparent_px > batch.shown_px[:, 0]) & (apparent_px <= batch.shown_px[:, 1])
        return shown & self._lens.touches(centres, batch.radii_m), distances

    def paint(self, image: Image, selection: Selection, view: View, after_s: float = 0.0) -> None:
        """Draw the faces as they stand `after_s` after their selection."""
        corners = selection.corners + selection.velocities_m_s[:, None] * after_s
        for number, polygon in self.polygons(corners, view, in_image_only=True):
            colour = selection.colours[number]
            cv2.fillConvexPoly(image, polygon, colour, cv2.LINE_AA, _SHIFT)

    def polygons(
        self, corners: Vector, view: View, in_image_only: bool = False
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

    def shade(self, image: Image, outline: Vector, view: View, darkness: float) -> None:
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
