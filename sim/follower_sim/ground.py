"""Draws the ground into a camera's image, with the far distance smoothed against aliasing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from follower_sim.ground_map import GroundMap
from follower_sim.mesh import Colour
from follower_sim.view import View
from follower_vision.frame import Image

Plane = npt.NDArray[np.float32]

_LOWEST_CAMERA_M = 0.05
_FARTHEST_M = 4000.0


@dataclass(frozen=True, slots=True)
class PixelRays:
    """For each pixel of an image the point (x, y, 1) on its line of sight, distortion removed."""

    x: Plane
    y: Plane
    focal_px: float

    def component(self, axis: npt.NDArray[np.float64], rows: slice = slice(None)) -> Plane:
        """Return the rays' component along an axis given in camera axes, (rows, W)."""
        a, b, c = (float(value) for value in axis)
        return np.asarray(cv2.addWeighted(self.x[rows], a, self.y[rows], b, c), np.float32)


class GroundPainter:
    """Paints the plane down = 0 from maps of increasing coarseness.

    Each map covers a band of depths in which its pixels are about as large as the camera's;
    the footprint is the geometric mean of its width and its length along the line of sight.

    Args:
        maps: from fine to coarse; the coarser ones reach farther.
        rays: of the camera's pixels.
        haze: colour of the far distance.
        visibility_m: distance at which haze has taken 63 % of the contrast.
    """

    def __init__(
        self, maps: Sequence[GroundMap], rays: PixelRays, haze: Colour, visibility_m: float
    ) -> None:
        self._maps = list(maps)
        self._rays = rays
        self._blank = np.full((*rays.x.shape, 3), haze, np.uint8)
        self._visibility_m = visibility_m

    def paint(self, image: Image, view: View) -> None:
        """Paint the ground over an image; pixels that see the sky stay as they are."""
        height = max(-float(view.position_m[2]), _LOWEST_CAMERA_M)
        sink = self._rays.component(view.world_to_camera[:, 2])
        limits = [0.0, *(self._depth_limit(m, height) for m in self._maps[1:]), _FARTHEST_M]
        low, high = _row_extremes(sink)
        for number in reversed(range(len(self._maps))):
            nearest = height / limits[number] if limits[number] > 0 else math.inf
            farthest = height / limits[number + 1]
            rows = _rows_between(low, high, farthest, nearest)
            if rows is not None:
                mask = cv2.inRange(sink[rows], (farthest,), (min(nearest, 1e9),))
                band = np.asarray(mask, np.uint8)
                self._paint_band(image[rows], band, number, sink[rows], rows, view, height)
        self._add_haze(image, sink, low, high, height)

    def _depth_limit(self, ground: GroundMap, height: float) -> float:
        """Return the depth from which on `ground` is fine enough."""
        pixel = 0.75 * ground.m_per_px * self._rays.focal_px
        return float((pixel * math.sqrt(height)) ** (2 / 3))

    def _paint_band(
        self,
        image: Image,
        mask: Image,
        number: int,
        sink: Plane,
        rows: slice,
        view: View,
        height: float,
    ) -> None:
        """Paint one band, and under it the far map where the scene's own maps end."""
        ground = self._maps[number]
        x, y = self._map_pixels(ground, sink, rows, view, height)
        if _covers(ground, x, y, mask):
            whole, fraction = cv2.convertMaps(x, y, cv2.CV_16SC2)
            part = cv2.remap(
                ground.image, whole, fraction, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
        else:
            part = self._with_far_map(ground, x, y)
        cv2.copyTo(part, mask, image)

    def _map_pixels(
        self, ground: GroundMap, sink: Plane, rows: slice, view: View, height: float
    ) -> tuple[Plane, Plane]:
        """Return where on the map each pixel looks, in OpenCV's coordinates."""
        north, east, down = (view.world_to_camera[:, i] for i in range(3))
        column = (float(view.position_m[1]) - ground.east_m) / ground.m_per_px - 0.5
        row = (ground.north_m - float(view.position_m[0])) / ground.m_per_px - 0.5
        reach = height / ground.m_per_px
        x = cv2.divide(self._rays.component(reach * east + column * down, rows), sink)
        y = cv2.divide(self._rays.component(row * down - reach * north, rows), sink)
        return np.asarray(x, np.float32), np.asarray(y, np.float32)

    def _with_far_map(self, ground: GroundMap, x: Plane, y: Plane) -> Image:
        far = next(m for m in self._maps if m.east_m != self._maps[0].east_m)
        scale = ground.m_per_px / far.m_per_px
        across = (ground.east_m - far.east_m) / far.m_per_px + 0.5 * scale - 0.5
        down = (far.north_m - ground.north_m) / far.m_per_px + 0.5 * scale - 0.5
        far_x, far_y = x * np.float32(scale) + across, y * np.float32(scale) + down
        part = cv2.remap(
            far.image,
            far_x.astype(np.float32),
            far_y.astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REFLECT,
        )
        cv2.remap(ground.image, x, y, cv2.INTER_LINEAR, part, cv2.BORDER_TRANSPARENT)
        return np.asarray(part, np.uint8)

    def _add_haze(self, image: Image, sink: Plane, low: Plane, high: Plane, height: float) -> None:
        """Blend what is far towards the haze, row by row where anything is far."""
        near = height / (0.06 * self._visibility_m)
        rows = _rows_between(low, high, height / _FARTHEST_M, near)
        if rows is None:
            return
        part = image[rows]
        inverse = cv2.divide(-height / self._visibility_m, np.maximum(sink[rows], 1e-6))
        clear = np.asarray(cv2.exp(inverse), np.float32)
        clear[sink[rows] < height / _FARTHEST_M] = 1
        cv2.blendLinear(part, self._blank[: len(part)], clear, 1 - clear, dst=part)


def _row_extremes(sink: Plane) -> tuple[Plane, Plane]:
    """Return each row's least and greatest value, as found in every eighth column."""
    some = np.hstack([sink[:, ::8], sink[:, -1:]])
    return some.min(axis=1), some.max(axis=1)


def _rows_between(low: Plane, high: Plane, least: float, most: float) -> slice | None:
    """Return the rows in which any value lies between two limits."""
    rows = np.flatnonzero((high >= least) & (low <= most))
    return slice(max(0, int(rows[0]) - 1), int(rows[-1]) + 2) if len(rows) else None


def _covers(ground: GroundMap, x: Plane, y: Plane, mask: Image) -> bool:
    height, width = ground.image.shape[:2]
    x_low, x_high, _, _ = cv2.minMaxLoc(x, mask)
    y_low, y_high, _, _ = cv2.minMaxLoc(y, mask)
    return x_low >= 0 and y_low >= 0 and x_high <= width - 1 and y_high <= height - 1
