"""Draws the ground into a camera's image, with the far distance smoothed against aliasing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

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
_STRIP_PX = 160


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

    def of_columns(self, columns: slice) -> PixelRays:
        """Return those of some columns alone."""
        x, y = (np.ascontiguousarray(plane[:, columns]) for plane in (self.x, self.y))
        return PixelRays(x, y, self.focal_px)


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
        self._focal_px = rays.focal_px
        self._strips = [_Strip(c, rays.of_columns(c)) for c in _columns(rays.x.shape[1])]
        self._blank = np.full((*rays.x.shape, 3), haze, np.uint8)
        self._visibility_m = visibility_m

    def paint(self, image: Image, view: View) -> None:
        """Paint the ground over an image; pixels that see the sky stay as they are."""
        height = max(-float(view.position_m[2]), _LOWEST_CAMERA_M)
        looks = [_Look.of(strip, view) for strip in self._strips]
        limits = [0.0, *(self._depth_limit(m, height) for m in self._maps[1:]), _FARTHEST_M]
        for number in reversed(range(len(self._maps))):
            nearest = height / limits[number] if limits[number] > 0 else math.inf
            self._paint_band(image, number, looks, (height / limits[number + 1], nearest), view)
        self._add_haze(image, looks, height)

    def _depth_limit(self, ground: GroundMap, height: float) -> float:
        """Return the depth from which on `ground` is fine enough."""
        pixel = 0.75 * ground.m_per_px * self._focal_px
        return float((pixel * math.sqrt(height)) ** (2 / 3))

    def _paint_band(
        self,
        image: Image,
        number: int,
        looks: Sequence[_Look],
        limits: tuple[float, float],
        view: View,
    ) -> None:
        """Paint one band, and under it the far map where the scene's own maps end.

        Args:
            image: to paint into.
            number: of the map.
            looks: of all strips.
            limits: of the sink in this band, the farthest's first.
            view: of the camera.
        """
        ground = self._maps[number]
        pieces = [
            _Piece.of(look, rows, ground, limits, view)
            for look in looks
            if (rows := look.rows_between(*limits)) is not None
        ]
        covered = all(_covers(ground, piece) for piece in pieces)
        for piece in pieces:
            if covered:
                part = _mapped(ground, piece)
            else:
                part = self._with_far_map(ground, piece.x, piece.y)
            cv2.copyTo(part, piece.mask, image[piece.rows, piece.columns])

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

    def _add_haze(self, image: Image, looks: Sequence[_Look], height: float) -> None:
        """Blend what is far towards the haze, in all rows from the first to the last far one."""
        near = height / (0.06 * self._visibility_m)
        each = [look.rows_between(height / _FARTHEST_M, near) for look in looks]
        far = [rows for rows in each if rows is not None]
        if not far:
            return
        rows = slice(min(one.start for one in far), max(one.stop for one in far))
        for look in looks:
            part, sink = image[rows, look.columns], look.sink[rows]
            inverse = cv2.divide(-height / self._visibility_m, np.maximum(sink, 1e-6))
            clear = np.asarray(cv2.exp(inverse), np.float32)
            clear[sink < height / _FARTHEST_M] = 1
            cv2.blendLinear(part, self._blank[rows, look.columns], clear, 1 - clear, dst=part)


@dataclass(frozen=True, slots=True)
class _Strip:
    """Some columns of the image, and the rays of their pixels.

    In few columns a band of depths takes few rows, however the camera rolls.
    """

    columns: slice
    rays: PixelRays


@dataclass(frozen=True, slots=True)
class _Look:
    """A strip in one view: how steeply each pixel looks down, and the extremes of each row."""

    strip: _Strip
    sink: Plane
    low: Plane
    high: Plane

    @classmethod
    def of(cls, strip: _Strip, view: View) -> Self:
        """Look down; a row's extremes are those of every eighth column."""
        sink = strip.rays.component(view.world_to_camera[:, 2])
        some = np.hstack([sink[:, ::8], sink[:, -1:]])
        return cls(strip, sink, some.min(axis=1), some.max(axis=1))

    @property
    def columns(self) -> slice:
        """The strip's columns of the image."""
        return self.strip.columns

    def rows_between(self, least: float, most: float) -> slice | None:
        """Return the rows in which any pixel's sink lies between two limits."""
        rows = np.flatnonzero((self.high >= least) & (self.low <= most))
        return slice(max(0, int(rows[0]) - 1), int(rows[-1]) + 2) if len(rows) else None


@dataclass(frozen=True, slots=True)
class _Piece:
    """What of a band is in a strip: which pixels, and where on the map each looks."""

    rows: slice
    columns: slice
    mask: Image
    x: Plane
    y: Plane

    @classmethod
    def of(
        cls, look: _Look, rows: slice, ground: GroundMap, limits: tuple[float, float], view: View
    ) -> Self:
        """Find the pixels whose sink lies within the limits; in OpenCV's coordinates."""
        sink = look.sink[rows]
        mask = cv2.inRange(sink, (limits[0],), (min(limits[1], 1e9),))
        north, east, down = (view.world_to_camera[:, i] for i in range(3))
        height = max(-float(view.position_m[2]), _LOWEST_CAMERA_M)
        column = (float(view.position_m[1]) - ground.east_m) / ground.m_per_px - 0.5
        row = (ground.north_m - float(view.position_m[0])) / ground.m_per_px - 0.5
        reach, rays = height / ground.m_per_px, look.strip.rays
        x = cv2.divide(rays.component(reach * east + column * down, rows), sink)
        y = cv2.divide(rays.component(row * down - reach * north, rows), sink)
        places = np.asarray(x, np.float32), np.asarray(y, np.float32)
        return cls(rows, look.columns, np.asarray(mask, np.uint8), *places)


def _columns(width: int) -> list[slice]:
    """Return the columns of the strips that an image of this width is painted in."""
    return [slice(at, min(at + _STRIP_PX, width)) for at in range(0, width, _STRIP_PX)]


def _mapped(ground: GroundMap, piece: _Piece) -> Image:
    whole, fraction = cv2.convertMaps(piece.x, piece.y, cv2.CV_16SC2)
    part = cv2.remap(
        ground.image, whole, fraction, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(part, np.uint8)


def _covers(ground: GroundMap, piece: _Piece) -> bool:
    """Whether a map reaches as far as a piece looks."""
    height, width = ground.image.shape[:2]
    x_low, x_high, _, _ = cv2.minMaxLoc(piece.x, piece.mask)
    y_low, y_high, _, _ = cv2.minMaxLoc(piece.y, piece.mask)
    return x_low >= 0 and y_low >= 0 and x_high <= width - 1 and y_high <= height - 1
