"""Renders what a camera in the simulated world sees."""

from __future__ import annotations

import math

import cv2
import numpy as np

from follower_sim.ground import GroundPainter, PixelRays
from follower_sim.kinematics import BodyState
from follower_sim.lens import Lens
from follower_sim.painter import SolidBatch, SolidPainter
from follower_sim.sky import SkyPainter
from follower_sim.view import View
from follower_sim.world import World
from follower_vision.camera import CameraModel
from follower_vision.frame import Image
from follower_vision.lineofsight import CameraMount

_SHADOW = 0.42
_STILL_PX = 0.6
_STEP_PX = 2.2
_MOST_STEPS = 3


def pixel_rays(camera: CameraModel) -> PixelRays:
    """Return the lines of sight of all pixel centres."""
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    rays = camera.rays(np.column_stack([columns.ravel(), rows.ravel()]))
    plane = (rays[:, :2] / rays[:, 2:]).astype(np.float32)
    shape = camera.height, camera.width
    x, y = (np.ascontiguousarray(plane[:, i]).reshape(shape) for i in (0, 1))
    return PixelRays(x, y, math.sqrt(camera.fx * camera.fy))


class Renderer:
    """Draws ground, sky and bodies through a camera model, with distortion and motion blur.

    Motion blur is the mean of up to three pictures taken during the exposure, each of which
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
        self._mount = mount or settings.mount
        rays = pixel_rays(camera)
        visibility = world.scenario.sky.visibility_m
        self._ground = GroundPainter(world.ground, rays, world.haze, visibility)
        self._sky = SkyPainter(world.sky, rays)
        self._solids = SolidPainter(Lens(camera))
        self._blank = np.full((camera.height, camera.width, 3), world.haze, np.uint8)

    def render(self, time_s: float, body: BodyState, exposure_s: float = 0.0) -> Image:
        """Return the image, (H, W, 3) uint8 BGR, of an exposure.

        Args:
            time_s: middle of the exposure, in the scenario's time.
            body: pose and motion of the vehicle at that time.
            exposure_s: how long it lasts; 0 is sharp.
        """
        count = self._steps(time_s, body, exposure_s)
        offsets = [exposure_s * ((i + 0.5) / count - 0.5) for i in range(count)]
        images = [self._instant(time_s + o, View.of(body, self._mount, o)) for o in offsets]
        return _mean(images)

    def _steps(self, time_s: float, body: BodyState, exposure_s: float) -> int:
        """Return how many pictures the blur needs."""
        if exposure_s <= 0:
            return 1
        flow = self._flow_px(time_s, body, exposure_s)
        if flow < _STILL_PX:
            return 1
        return min(_MOST_STEPS, max(2, math.ceil(flow / _STEP_PX)))

    def _flow_px(self, time_s: float, body: BodyState, exposure_s: float) -> float:
        """Estimate the largest motion in the image during the exposure, in pixels."""
        turn = float(np.linalg.norm(body.rates_rad_s)) * exposure_s
        focal = max(self._camera.fx, self._camera.fy)
        followed = self._world.scenario.followed
        target = self._world.target_pose(followed, time_s)
        here, there = np.array(body.position_m), np.array(target.position_m)
        away = max(1.0, float(np.linalg.norm(there - here)))
        own = float(np.linalg.norm(body.velocity_m_s)) * exposure_s
        its = float(np.linalg.norm(target.velocity_m_s)) * exposure_s
        nearest = max(1.0, 1.2 * -body.position_m[2])
        return focal * (turn + max(own / nearest, (own + its) / away))

    def _instant(self, time_s: float, view: View) -> Image:
        image = self._blank.copy()
        self._sky.paint(image, view)
        self._ground.paint(image, view)
        moving = self._world.moving(time_s)
        for solid in moving:
            self._solids.shade(image, solid.shadow(self._world.sun), view, _SHADOW)
        batch = self._world.scenery_batch.joined(SolidBatch.of(moving))
        self._solids.paint(image, batch, view)
        return image


def _mean(images: list[Image]) -> Image:
    if len(images) == 1:
        return images[0]
    total = cv2.addWeighted(images[0], 0.5, images[1], 0.5, 0)
    if len(images) == 3:
        total = cv2.addWeighted(total, 2 / 3, images[2], 1 / 3, 0)
    return np.asarray(total, np.uint8)
