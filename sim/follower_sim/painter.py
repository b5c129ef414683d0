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
            np.array([s.shown_px for s in solids]).reshape(-1, 2),
        )  # fmt: skip

    def joined(self, other: SolidBatch) -> SolidBatch:
        """Return both batches as one."""
        return SolidBatch(
            np.vstack([self.vertices, other.vertices]),
            np.vstack([self.faces, other.faces + len(self.vertices)]),
            np.vstack([self.normals, other.normals]),
            np.vstack([self.face_centres, other.face_centres]),
            np.vstack([self.colours, other.colours]),
            np.concatenate([self.layers, other.layers]),
            np.concatenate([self.owners, other.owners + len(self.centres)]),
            np.vstack([self.centres, other.centres]),
            np.concatenate([self.radii_m, other.radii_m]),
            np.vstack([self.shown_px, other.shown_px]),
        )


class SolidPainter:
    """Draws batches of solids, and the shadows of moving ones, through a lens."""

    def __init__(self, lens: Lens) -> None:
        self._lens = lens
        self._focal_px = max(lens.camera.fx, lens.camera.fy)

    def paint(self, image: Image, batch: SolidBatch, view: View) -> None:
        """Draw all faces that look towards the camera, the farthest solid's first."""
        for polygon, colour in self.polygons(batch, view):
            cv2.fillConvexPoly(image, polygon, colour, cv2.LINE_AA, _SHIFT)

    def polygons(
        self, batch: SolidBatch, view: View
    ) -> Iterator[tuple[FixedPoints, tuple[float, float, float]]]:
        """Yield the image polygons, in OpenCV's fixed point, with colours, in painting order."""
        near, distances = self._near_solids(batch, view)
        towards = np.einsum("ij,ij->i", batch.normals, batch.face_centres - view.position_m) < 0
        chosen = np.flatnonzero(near[batch.owners] & towards)
        corners = view.to_camera(batch.vertices[batch.faces[chosen]]).reshape(-1, 4, 3)
        outside = self._lens.outside(corners)
        seen = ~outside.all(axis=1).any(axis=1)
        chosen, corners, outside = chosen[seen], corners[seen], outside[seen]
        order = self._painting_order(batch, chosen, corners, distances)
        cut = outside.any(axis=(1, 2))
        fixed = self._fixed(np.where(cut[:, None, None], (0.0, 0.0, 1.0), corners))
        colours = batch.colours[chosen].tolist()
        for i in order:
            polygon = self._cut_polygon(corners[i]) if cut[i] else fixed[i]
            if polygon is not None:
                yield polygon, colours[i]

    def _near_solids(self, batch: SolidBatch, view: View) -> tuple[npt.NDArray[np.bool_], Vector]:
        """Return which solids are to be drawn at their distance, and how far each is."""
        centres = view.to_camera(batch.centres)
        distances = np.asarray(np.linalg.norm(centres, axis=1))
        apparent_px = batch.radii_m * self._focal_px / np.maximum(distances, 1e-9)
        shown = (apparent_px > batch.shown_px[:, 0]) & (apparent_px <= batch.shown_px[:, 1])
        return shown & (centres[:, 2] > -batch.radii_m), distances

    def _painting_order(
        self,
        batch: SolidBatch,
        chosen: npt.NDArray[np.intp],
        corners: Vector,
        distances: Vector,
    ) -> list[int]:
        depth = np.linalg.norm(corners.mean(axis=1), axis=1)
        owners = batch.owners[chosen]
        keys = (-depth, batch.layers[chosen], owners, -distances[owners])
        return [int(i) for i in np.lexsort(keys)]

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
        offset = (area[1].start << _SHIFT, area[0].start << _SHIFT)
        shade = round(255 * (1 - darkness))
        cv2.fillConvexPoly(light, fixed - np.int32(offset), shade, cv2.LINE_AA, _SHIFT)
        soft = cv2.merge([cv2.blur(light, (5, 5))] * 3)
        cv2.multiply(part, soft, dst=part, scale=1 / 255)


def _inflated(box: Sequence[int], image: Image) -> tuple[slice, slice] | None:
    """Return the slices of a box and 3 px about it, or None outside the image."""
    x, y, width, height = box
    rows = slice(max(0, y - 3), min(image.shape[0], y + height + 3))
    columns = slice(max(0, x - 3), min(image.shape[1], x + width + 3))
    empty = rows.start >= rows.stop or columns.start >= columns.stop
    return None if empty else (rows, columns)
