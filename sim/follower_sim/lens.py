"""Projection of faces onto the image, with what lies outside the view cut away first."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from follower_sim.kinematics import Triple
from follower_vision.camera import CameraModel, Vector

NEAR_M = 0.15
_WIDEST_GUARD = 3.0


class Lens:
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
            kept.append(_between(before, corner, share))
        if height >= 0:
            kept.append(corner)
    return kept


def _between(a: Triple, b: Triple, share: float) -> Triple:
    return (
        a[0] + share * (b[0] - a[0]),
        a[1] + share * (b[1] - a[1]),
        a[2] + share * (b[2] - a[2]),
    )


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
