"""Draws the ground into a camera's image, with the far distance smoothed against aliasing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
import numpy.typing as npt

from follower_sim.bodies.mesh import Colour
from follower_sim.view import CameraView
from follower_sim.world.ground_pyramid import Ground, GroundPyramid, Levels, Plane
from follower_sim.world.weather import AIR_LIGHT, Fog
from follower_vision.images.frame import Image

_LOWEST_CAMERA_M = 0.05
_FARTHEST_M = 4000.0
_STEEPEST = 1e9
_CLEAR_AIR = 0.06
_STRIP_PX = 32


@dataclass(frozen=True, slots=True)
class PixelRays:
    """For each pixel of an image the point (x, y, 1) on its line of sight, distortion removed."""

    x: Plane
    y: Plane
    focal_px: float

    def component(self, axis: npt.NDArray[np.float64]) -> Plane:
        """Return the rays' component along an axis given in camera axes, (H, W)."""
        a, b, c = (float(value) for value in axis)
        return np.asarray(cv2.addWeighted(self.x, a, self.y, b, c), np.float32)

    def of_rows(self, rows: slice) -> PixelRays:
        """Return those of some rows alone."""
        return PixelRays(self.x[rows], self.y[rows], self.focal_px)


class GroundPainter:
    """Paints the plane down = 0 from maps of increasing coarseness.

    Each map covers a band of depths in which its pixels are about as large as the camera's;
    the footprint is the geometric mean of its width and its length along the line of sight.
    The image is painted in strips of few rows, whose numbers stay in the processor's caches.

    Args:
        ground: near and far.
        rays: of the camera's pixels.
        haze: colour of the far distance.
        visibility_m: distance at which haze has taken 63 % of the contrast.
        fog: over all of it, None in clear air.
    """

    def __init__(
        self,
        ground: Ground,
        rays: PixelRays,
        haze: Colour,
        visibility_m: float,
        fog: Fog | None = None,
    ) -> None:
        self._ground = ground
        self._focal_px = rays.focal_px
        height, width = rays.x.shape
        rows = [slice(at, min(at + _STRIP_PX, height)) for at in range(0, height, _STRIP_PX)]
        self._strips = [(one, rays.of_rows(one)) for one in rows]
        self._blank = np.full((_STRIP_PX, width, 3), haze, np.uint8)
        self._visibility_m = visibility_m
        self._fog = fog
        self._air = np.full_like(self._blank, AIR_LIGHT)

    def paint(self, image: Image, view: CameraView) -> None:
        """Paint the ground over an image; pixels that see the sky stay as they are."""
        height = max(-float(view.position_m[2]), _LOWEST_CAMERA_M)
        for rows, rays in self._strips:
            look = _Look.of(rays, view, height)
            if look.most >= look.farthest:
                self._paint_strip(image[rows], look)

    def _paint_strip(self, part: Image, look: _Look) -> None:
        near, far = self._ground.near, self._ground.far
        nearer = look.height_m / self._depth_limit(far.m_per_px[0], look.height_m)
        if look.most < nearer:
            self._paint_far(part, look)
        else:
            south, across = look.places(near)
            shown = _between(look.sink, nearer, _STEEPEST, (look.least, look.most))
            shown = _both(shown, near.covers(south, across))
            if shown is not None:
                self._paint_far(part, look)
            _paint(part, near, (south, across), self._levels(near, look), shown)
        self._add_haze(part, look)
        if self._fog is not None:
            self._fog.over_plane(part, look.distances_m, self._air[: len(part)])

    def _paint_far(self, part: Image, look: _Look) -> None:
        far = self._ground.far
        shown = _between(look.sink, look.farthest, _STEEPEST, (look.least, look.most))
        places = far.mirrored(*look.places(far))
        _paint(part, far, places, self._levels(far, look), shown)

    def _levels(self, ground: GroundPyramid, look: _Look) -> Levels | int:
        """Return which map is the coarsest that is fine enough, for each pixel or for all."""
        height = look.height_m
        limits = [height / self._depth_limit(one, height) for one in ground.m_per_px[1:]]
        level = sum(look.most < limit for limit in limits)
        between = [limit for limit in limits if look.least < limit <= look.most]
        if not between:
            return level
        levels = np.full(look.sink.shape, level, np.uint8)
        for limit in between:
            levels += (look.sink < np.float32(limit)).view(np.uint8)
        return levels

    def _depth_limit(self, m_per_px: float, height_m: float) -> float:
        """Return the depth from which on a map is fine enough."""
        pixel = 0.75 * m_per_px * self._focal_px
        return float((pixel * math.sqrt(height_m)) ** (2 / 3))

    def _add_haze(self, part: Image, look: _Look) -> None:
        """Blend what is far towards the haze, the more the farther it is behind clear air."""
        begins = look.height_m / (_CLEAR_AIR * self._visibility_m)
        if look.least >= begins:
            return
        sink = look.sink.clip(np.float32(look.farthest), np.float32(begins))
        air = np.float32(-look.height_m / self._visibility_m) / sink + np.float32(_CLEAR_AIR)
        clear = np.asarray(cv2.exp(air), np.float32)
        if look.least < look.farthest:
            clear[look.sink < look.farthest] = 1
        cv2.blendLinear(part, self._blank[: len(part)], clear, 1 - clear, dst=part)


@dataclass(frozen=True, slots=True)
class _Look:
    """One view of the ground.

    Attributes:
        rays: of some pixels, (rows, W).
        view: from where.
        height_m: above the ground.
        sink: (rows, W) how steeply each pixel looks down: the ray's component downward.
        least, most: of the sink.
    """

    rays: PixelRays
    view: CameraView
    height_m: float
    sink: Plane
    least: float
    most: float

    @classmethod
    def of(cls, rays: PixelRays, view: CameraView, height_m: float) -> Self:
        """Look down."""
        sink = rays.component(view.world_to_camera[:, 2])
        least, most, _, _ = cv2.minMaxLoc(sink)
        return cls(rays, view, height_m, sink, least, most)

    @property
    def farthest(self) -> float:
        """The sink of the farthest ground that is painted."""
        return self.height_m / _FARTHEST_M

    @property
    def distances_m(self) -> Plane:
        """How far away the ground is, (rows, W); 0 where there is none."""
        x, y, sink = self.rays.x, self.rays.y, self.sink
        per_depth = np.sqrt(x * x + y * y + np.float32(1)) * np.float32(self.height_m)
        far = per_depth / np.maximum(sink, np.float32(self.farthest))
        return np.where(sink < np.float32(self.farthest), np.float32(0), far)

    def places(self, ground: GroundPyramid) -> tuple[Plane, Plane]:
        """Return how many metres south and east of the ground's upper left corner pixels look."""
        north, east, down = (self.view.world_to_camera[:, i] for i in range(3))
        south_m = ground.north_m - float(self.view.position_m[0])
        across_m = float(self.view.position_m[1]) - ground.east_m
        # What sees the sky is held to look far away, so that all places are finite.
        sink, height = self.sink, self.height_m
        if self.least < self.farthest:
            sink = np.maximum(sink, np.float32(self.farthest))
        south = cv2.divide(self.rays.component(south_m * down - height * north), sink)
        across = cv2.divide(self.rays.component(across_m * down + height * east), sink)
        return np.asarray(south, np.float32), np.asarray(across, np.float32)


def _between(
    values: Plane, least: float, most: float, extremes: tuple[float, float]
) -> Image | None:
    """Return 255 where values lie between two limits, (rows, W); None if all do."""
    if least <= extremes[0] and extremes[1] <= most:
        return None
    return np.asarray(cv2.inRange(values, (least,), (most,)), np.uint8)


def _both(one: Image | None, other: Image | None) -> Image | None:
    if one is None or other is None:
        return other if one is None else one
    return np.asarray(cv2.bitwise_and(one, other), np.uint8)


def _paint(
    part: Image,
    ground: GroundPyramid,
    places: tuple[Plane, Plane],
    levels: Levels | int,
    shown: Image | None,
) -> None:
    """Paint places over a part of an image, where a mask is not 0; everywhere if it is None."""
    if shown is None:
        ground.look(*places, levels, into=part)
    else:
        cv2.copyTo(ground.look(*places, levels), shown, part)
