"""Fog and rain between a camera and the world."""

from __future__ import annotations

import math
from typing import Self

import cv2
import numpy as np

from follower_control.common.small_matrix import product
from follower_sim.kinematics import BodyState, Triple
from follower_sim.scenario.weather import WeatherSettings
from follower_sim.world.ground_pyramid import Plane
from follower_vision.geometry.camera_model import CameraModel, Vector
from follower_vision.geometry.line_of_sight import CameraMount
from follower_vision.images.frame import Image

AIR_LIGHT = (208, 205, 201)
_FOG_LAYER_M = 150.0

_STREAM = 17
_DROP_M, _FALL_M_S = 0.0025, (0.0, 0.0, 7.4)
_LEAST_MM, _PER_M3_MM = 2.0, 8000.0
_LENS_M, _NEAREST_M, _FARTHEST_M = 0.15, 0.25, 3.0
_BESIDE = 1.15
_DROP_LIGHT, _OPACITY = 222, 0.5
_SHADES = 4
_SHIFT = 4


class Fog:
    """Takes light away with distance and puts the air's own in its place (Koschmieder).

    Args:
        per_m: extinction coefficient.
    """

    def __init__(self, per_m: float) -> None:
        self._per_m = per_m

    @classmethod
    def of(cls, weather: WeatherSettings) -> Self | None:
        """Return the fog of a weather, None in clear air."""
        per_m = weather.extinction_per_m
        return cls(per_m) if per_m > 0 else None

    def clear(self, distance_m: float) -> float:
        """Return the share of the light that comes through a distance."""
        return math.exp(-self._per_m * distance_m)

    def over(self, colours: Vector, distances_m: Vector) -> Vector:
        """Return colours, (N, 3) BGR, as they look from distances, (N,)."""
        clear = np.exp(-self._per_m * distances_m)[:, None]
        return np.asarray(colours * clear + np.array(AIR_LIGHT) * (1 - clear))

    def over_plane(self, part: Image, distances_m: Plane, air: Image) -> None:
        """Put fog over a part of an image, at (H, W) distances; `air` is as large and all air."""
        clear = np.asarray(cv2.exp(distances_m * np.float32(-self._per_m)), np.float32)
        cv2.blendLinear(part, air, clear, 1 - clear, dst=part)

    def over_sky(self, sky: Image, elevations_deg: Vector) -> Image:
        """Return a panorama, (H, W, 3), whose rows lie at elevations, (H,), above a fog layer."""
        rise = np.sin(np.radians(np.maximum(elevations_deg, 0.05)))
        clear = np.exp(-self._per_m * _FOG_LAYER_M / rise)[:, None, None]
        return np.asarray(sky * clear + np.array(AIR_LIGHT) * (1 - clear), np.uint8)


class Rain:
    """Draws the drops near a camera as streaks: as long as they move in its axes while it exposes.

    How many drops of more than 2 mm there are follows Marshall and Palmer (1948). All fall at one
    speed, with the wind, and are drawn as far as 3 m: thick where near, thin and faint where far.
    Those beyond are part of the fog. Streaks are more opaque than so short an exposure would make
    them. No drop is in two pictures: in a thirtieth of a second it falls out of most views.

    Args:
        rain_mm_h: rate of the rain.
        camera: that looks into it.
        mount: of the camera.
        seed: of where the drops are.
    """

    def __init__(
        self, rain_mm_h: float, camera: CameraModel, mount: CameraMount, seed: int
    ) -> None:
        self._camera, self._mount, self._seed = camera, mount, seed
        slope = 4.1 * rain_mm_h**-0.21
        per_m3 = _PER_M3_MM / slope * math.exp(-slope * _LEAST_MM)
        corners = np.array([(0, 0), (camera.width, camera.height)])
        rays = camera.rays(corners)
        self._reach = _BESIDE * np.abs(rays[:, :2] / rays[:, 2:]).max(axis=0)
        volume = 4 * float(self._reach[0] * self._reach[1]) * (_FARTHEST_M**3 - _NEAREST_M**3) / 3
        self._count = per_m3 * volume
        size = camera.height, camera.width
        self._light = np.full((*size, 3), _DROP_LIGHT, np.uint8)

    def fall(
        self, image: Image, time_s: float, body: BodyState, exposure_s: float, wind_m_s: Triple
    ) -> Image:
        """Return an image, (H, W, 3), with the drops of one exposure; the same for the same time.

        Args:
            image: without them.
            time_s: middle of the exposure.
            body: carries the camera.
            exposure_s: how long it lasts.
            wind_m_s: the air's velocity, (north, east, down).
        """
        words = np.array([time_s]).view(np.uint32).tolist()
        rng = np.random.default_rng([self._seed, _STREAM, *words])
        drops = self._drops(rng)
        moved = self._velocities(drops, body, wind_m_s) * (exposure_s / 2)
        begin, end = (
            self._camera.pixels(drops + _before_the_lens(drops, side * moved)) for side in (-1, 1)
        )
        width_px = self._camera.fx * _DROP_M / drops[:, 2]
        cover = self._cover(np.stack([begin, end], axis=1), width_px)
        return np.asarray(cv2.blendLinear(image, self._light, 1 - cover, cover), np.uint8)

    def _drops(self, rng: np.random.Generator) -> Vector:
        """Return places, (N, 3) in camera axes, as many in each cubic metre."""
        count = rng.poisson(self._count)
        depth = np.cbrt(rng.uniform(_NEAREST_M**3, _FARTHEST_M**3, count))
        beside = rng.uniform(-1, 1, (count, 2)) * self._reach
        return np.column_stack([beside * depth[:, None], depth])

    def _velocities(self, drops: Vector, body: BodyState, wind_m_s: Triple) -> Vector:
        """Return how the drops move against the turning camera, (N, 3) m/s in its axes."""
        camera_to_body = self._mount.camera_to_body
        world_to_camera = product(body.body_to_world, camera_to_body).T
        relative = np.array(wind_m_s) + np.array(_FALL_M_S) - np.array(body.velocity_m_s)
        turning = camera_to_body.T @ np.array(body.rates_rad_s)
        return np.asarray(world_to_camera @ relative - np.cross(turning, drops))

    def _cover(self, streaks: Vector, width_px: Vector) -> Plane:
        """Return how much of each pixel the streaks, (N, 2, 2) in pixels, cover, (H, W)."""
        mask = np.zeros(self._light.shape[:2], np.uint8)
        shade = np.ceil(_SHADES * np.minimum(width_px, 1)).astype(np.intp)
        thick = np.maximum(1, np.round(width_px)).astype(np.intp)
        fixed = np.round((streaks - 0.5) * (1 << _SHIFT))
        fixed = np.clip(fixed, -(1 << 19), 1 << 19).astype(np.int32)
        for grade, px in sorted(set(zip(shade.tolist(), thick.tolist(), strict=True))):
            lines = list(fixed[(shade == grade) & (thick == px)])
            value = round(255 * _OPACITY * grade / _SHADES)
            cv2.polylines(mask, lines, False, value, px, cv2.LINE_AA, _SHIFT)
        return np.asarray(mask * np.float32(1 / 255), np.float32)


def _before_the_lens(drops: Vector, moved: Vector) -> Vector:
    """Cut the ways of drops, (N, 3), short where they pass the camera: behind it is no image."""
    nearer = np.maximum(-moved[:, 2:], 1e-9)
    return np.asarray(moved * np.minimum((drops[:, 2:] - _LENS_M) / nearer, 1))
