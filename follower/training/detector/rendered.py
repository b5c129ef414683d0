"""Pictures from the simulator's renderer, streamed from a seed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np

from follower.training.detector.distort import distorted, mirrored
from follower.training.detector.labelled import IGNORED, LabelledImage
from follower.training.detector.stage import KINDS, StagedWorld, random_stage, random_world
from follower.training.detector.views import shown
from follower_sim.kinematics import BodyState
from follower_sim.render import Renderer
from follower_sim.silhouettes import Silhouettes
from follower_sim.view import View
from follower_vision.box import Box
from follower_vision.camera import CameraModel
from follower_vision.frame import Image
from follower_vision.lineofsight import CameraMount

_LEAST_VISIBLE = 0.4
_HIDDEN = 0.1
_SMALLEST_PX = 5.0
_FLYING_M = 4.0
_MOUNT = CameraMount()


@dataclass(frozen=True, slots=True)
class RenderedPictures:
    """Scenes with car, person, boat and quadrotor among clutter.

    Each world gives several pictures with other bodies, places and lenses, and each of those
    several views: the whole picture as a search sees it, and crops as a validation does. A buffer
    mixes the views of some worlds.

    Attributes:
        width: of the rendered pictures, in pixels.
        height: likewise.
        pictures_a_world: rendered in one world.
        views_a_picture: cut from one rendered picture.
        mixed: how many views the buffer holds.
        shown_times: how often a view is shown in the mean; to make one takes longer than to learn
            from it.
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    width: int = 640
    height: int = 480
    pictures_a_world: int = 50
    views_a_picture: int = 5
    mixed: int = 800
    shown_times: int = 4

    def __post_init__(self) -> None:
        for name in ("pictures_a_world", "views_a_picture", "mixed", "shown_times"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is at least 1, not {getattr(self, name)}")
        if min(self.width, self.height) < 64:
            raise ValueError(f"pictures are at least 64 pixels wide and high, not {self.width}")

    @property
    def class_names(self) -> tuple[str, ...]:
        """The simulator's targets."""
        return tuple(KINDS)

    def training(self, side: int, seed: int) -> Iterator[LabelledImage]:
        """Return an endless stream of views; one seed, one stream."""
        rng = np.random.default_rng([seed, 1])
        views = self._views(side, rng)
        buffer: list[LabelledImage] = []
        for view in views:
            if len(buffer) < self.mixed:
                buffer.append(view)
            else:
                buffer[int(rng.integers(len(buffer)))] = view
            for _ in range(self.shown_times):
                chosen = buffer[int(rng.integers(len(buffer)))]
                yield chosen if rng.random() < 0.5 else mirrored(chosen)

    def held_out(self, side: int, count: int) -> list[LabelledImage]:
        """Return `count` views of worlds that no training's seed leads to."""
        rng = np.random.default_rng([0, 2])
        few = RenderedPictures(self.width, self.height, 10, self.views_a_picture)
        views = few._views(side, rng)
        return [next(views) for _ in range(count)]

    def _views(self, side: int, rng: np.random.Generator) -> Iterator[LabelledImage]:
        while True:
            world = random_world(rng)
            camera = CameraModel.from_fov(
                self.width, self.height, math.radians(float(rng.uniform(45, 95)))
            )
            renderer = Renderer(world, camera, _MOUNT)
            silhouettes = Silhouettes(camera, world.scenery)
            for _ in range(self.pictures_a_world):
                picture = distorted(_picture(world, renderer, silhouettes, rng), rng)
                for _ in range(self.views_a_picture):
                    yield shown(picture, side, rng)


def _picture(
    world: StagedWorld, renderer: Renderer, silhouettes: Silhouettes, rng: np.random.Generator
) -> LabelledImage:
    world.stage = random_stage(world, rng)
    body = looking(world, rng)
    image = _moved(renderer.render(0.0, body), rng)
    boxes, classes = [], []
    for box, kind in _seen(world, silhouettes, View.of(body, _MOUNT)):
        boxes.append((box.left, box.top, box.right, box.bottom))
        classes.append(kind)
    return LabelledImage(
        image, np.array(boxes, np.float32).reshape(-1, 4), np.array(classes, np.intp)
    )


def _seen(world: StagedWorld, silhouettes: Silhouettes, view: View) -> Iterator[tuple[Box, int]]:
    """Yield the boxes of what shows enough; `IGNORED` for what shows a little."""
    solids = [actor.solid for actor in world.stage]
    for number, actor in enumerate(world.stage):
        if actor.kind is None:
            continue
        others = [*solids[:number], *solids[number + 1 :]]
        seen = silhouettes.seen(actor.solid, others, view)
        if seen.box is None or seen.visible_share < _HIDDEN or seen.in_frame_share <= 0:
            continue
        clear = seen.visible_share >= _LEAST_VISIBLE and max(seen.box.xywh[2:]) >= _SMALLEST_PX
        yield seen.box, actor.kind if clear else IGNORED


def looking(world: StagedWorld, rng: np.random.Generator) -> BodyState:
    """Return a camera in the air that looks somewhere near a body; one in ten straight down."""
    wanted = [actor.solid for actor in world.stage if actor.kind is not None]
    solid = wanted[int(rng.integers(len(wanted)))]
    centre, size = solid.centre, 2 * solid.radius_m
    away = size * float(np.exp(rng.uniform(math.log(1.6), math.log(9))))
    lowest = -0.5 if -centre[2] > _FLYING_M else math.asin(min(0.7, 1.2 / away))
    elevation = float(rng.uniform(lowest, 1.0)) if rng.random() < 0.9 else 1.45
    azimuth = float(rng.uniform(-math.pi, math.pi))
    level = away * math.cos(elevation)
    position = centre - np.array(
        [level * math.cos(azimuth), level * math.sin(azimuth), away * math.sin(elevation)]
    )
    position[2] = min(position[2], -1.2)
    ahead = centre - position
    pitch = math.atan2(-ahead[2], math.hypot(ahead[0], ahead[1])) + float(rng.normal(0, 0.12))
    attitude = (float(rng.normal(0, 0.1)), pitch, azimuth + float(rng.normal(0, 0.2)))
    place = (float(position[0]), float(position[1]), float(position[2]))
    return BodyState(0.0, place, attitude_rad=attitude)


def _moved(image: Image, rng: np.random.Generator) -> Image:
    """Blur one picture in four along a random direction, as a turning camera does."""
    if rng.random() > 0.25:
        return image
    length, angle = float(rng.uniform(2, 13)), float(rng.uniform(0, math.pi))
    side = 2 * math.ceil(length / 2) + 1
    kernel = np.zeros((side, side), np.float32)
    reach = length / 2 * np.array([math.cos(angle), math.sin(angle)])
    middle = side // 2
    ends: Sequence[tuple[int, int]] = [
        (round(middle + s * reach[0]), round(middle + s * reach[1])) for s in (-1, 1)
    ]
    cv2.line(kernel, ends[0], ends[1], (1.0,), 1)
    return np.asarray(cv2.filter2D(image, -1, kernel / kernel.sum()), np.uint8)
