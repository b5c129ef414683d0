"""Renders what a camera in the simulated world sees."""

import math
from collections.abc import Sequence

import cv2
import numpy as np

from follower_sim.kinematics import BodyState, Triple
from follower_sim.view import CameraView
from follower_sim.world.ground import GroundPainter, PixelRays
from follower_sim.world.painter import LensProjection, SolidBatch, SolidPainter
from follower_sim.world.sky import SkyPainter, elevations_deg
from follower_sim.world.weather import Fog, Rain
from follower_sim.world.world import World
from follower_vision.geometry.camera_model import CameraModel, Vector
from follower_vision.geometry.line_of_sight import CameraMount
from follower_vision.images.frame import Image

_SHADOW = 0.42
_STILL_PX = 0.8
_STEP_PX = 2.2


def pixel_rays(camera: CameraModel) -> PixelRays:
    """Return the lines of sight of all pixel centres."""
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rays = camera.rays(np.column_stack([columns.ravel(), rows.ravel()]))
    plane = (rays[:, :2] / rays[:, 2:]).astype(np.float32)
    shape = camera.height, camera.width
    x, y = (np.ascontiguousarray(plane[:, i]).reshape(shape) for i in (0, 1))
    return PixelRays(x, y, math.sqrt(camera.fx * camera.fy))


class Renderer:
    """Draws ground, sky, bodies and weather through a lens, with distortion and motion blur.

    Motion blur is the mean of up to `blur_steps` pictures taken during the exposure, each of which
    moves camera and targets; how many depends on how far things move in the image.

    Args:
        world: what there is to see.
        camera: intrinsics and distortion; the scenario's own if None.
        mount: how the camera is turned against the vehicle's body; the scenario's own if None.
    """

    def __init__(
        self, world: World, camera: CameraModel | None = None, mount: CameraMount | None = None
    ) -> None:
        settings = world.scenario.camera
        camera = camera or settings.model
        self._world = world
        self._camera = camera
        self._most_steps = settings.blur_steps
        self._mount = mount or settings.mount
        rays = pixel_rays(camera)
        visibility = world.scenario.sky.visibility_m
        weather = world.scenario.weather
        self._fog = fog = Fog.of(weather)
        self._ground = GroundPainter(world.ground, rays, world.haze, visibility, fog)
        sky = world.sky if fog is None else fog.over_sky(world.sky, elevations_deg(len(world.sky)))
        self._sky = SkyPainter(sky, rays)
        self._solids = SolidPainter(LensProjection(camera), fog)
        self._rain = (
            Rain(weather.rain_mm_h, camera, self._mount, world.seed)
            if weather.rain_mm_h > 0
            else None
        )
        self._blank = np.full((camera.height, camera.width, 3), world.haze, np.uint8)

    def render(self, time_s: float, body: BodyState, exposure_s: float = 0.0) -> Image:
        """Return the image, (H, W, 3) uint8 BGR, of an exposure.

        Args:
            time_s: middle of the exposure, in the scenario's time.
            body: pose and motion of the vehicle at that time.
            exposure_s: how long it lasts; 0 is sharp.
        """
        moving = self._world.moving(time_s)
        batches = [self._world.scenery_batch, SolidBatch.of(moving)]
        selection = self._solids.select(batches, CameraView.of(body, self._mount))
        shadows = [(solid.shadow(self._world.sun), solid.velocity_m_s) for solid in moving]
        count = self._steps(time_s, body, exposure_s)
        images = []
        for i in range(count):
            after_s = exposure_s * ((i + 0.5) / count - 0.5)
            view = CameraView.of(body, self._mount, after_s)
            image = self._background(view, shadows, after_s)
            self._solids.paint(image, selection, view, after_s)
            images.append(image)
        if self._rain is None:
            return _mean(images)
        wind = self._world.wind.velocity_m_s(time_s)
        return self._rain.fall(_mean(images), time_s, body, exposure_s, wind)

    def _steps(self, time_s: float, body: BodyState, exposure_s: float) -> int:
        """Return how many pictures the blur needs."""
        if exposure_s <= 0:
            return 1
        flow = self._flow_px(time_s, body, exposure_s)
        if flow < _STILL_PX:
            return 1
        return min(self._most_steps, max(2, math.ceil(flow / _STEP_PX)))

    def _flow_px(self, time_s: float, body: BodyState, exposure_s: float) -> float:
        """Estimate the largest visible motion in the image during the exposure, in pixels.

        The camera's turning moves everything. Its travel moves the ground by as many metres
        everywhere, which cannot be seen while they are fewer than a pixel of the ground's map.
        """
        turn = float(np.linalg.norm(body.rates_rad_s)) * exposure_s
        own = np.array(body.velocity_m_s) * exposure_s
        grain = self._world.ground.near.m_per_px[0]
        height = max(1.0, 1.2 * -body.position_m[2])
        over_ground = max(0.0, float(np.linalg.norm(own)) - grain) / height
        past = max(
            self._passing_rad(number, time_s, body, own, exposure_s)
            for number in range(len(self._world.paths))
        )
        return max(self._camera.fx, self._camera.fy) * (turn + max(over_ground, past))

    def _passing_rad(
        self, number: int, time_s: float, body: BodyState, own: Vector, exposure_s: float
    ) -> float:
        """Return the angle by which a target passes the camera during the exposure."""
        pose = self._world.target_pose(number, time_s)
        away = np.array(pose.position_m) - np.array(body.position_m)
        passed = np.array(pose.velocity_m_s) * exposure_s - own
        distance = max(1.0, float(np.linalg.norm(away)))
        return float(np.linalg.norm(np.cross(away, passed))) / distance**2

    def _background(
        self, view: CameraView, shadows: Sequence[tuple[Vector, Triple]], after_s: float
    ) -> Image:
        """Draw sky, ground and the shadows of what moves."""
        image = self._blank.copy()
        self._sky.paint(image, view)
        self._ground.paint(image, view)
        for outline, velocity in shadows:
            moved = outline + np.array(velocity[:2]) * after_s
            away = np.append(moved.mean(axis=0), 0.0) - view.position_m
            clear = 1.0 if self._fog is None else self._fog.clear(float(np.linalg.norm(away)))
            self._solids.shade(image, moved, view, _SHADOW * clear)
        return image


def _mean(images: Sequence[Image]) -> Image:
    total = images[0]
    for count, image in enumerate(images[1:], start=2):
        total = np.asarray(cv2.addWeighted(total, 1 - 1 / count, image, 1 / count, 0), np.uint8)
    return total
