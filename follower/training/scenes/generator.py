"""Composes random scenes, of a chosen difficulty: the streaming data generator."""

import dataclasses
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import Field
from pydantic.dataclasses import dataclass

from follower.training.scenes.image_source import (
    Cutout,
    ImageSource,
    Matrix,
    cut,
    random_mask,
    stretch_and_shift,
)
from follower.training.scenes.scene import (
    Course,
    Layer,
    Light,
    Scene,
    Turning,
    folded,
    hover,
    random_bending,
    wander,
)
from follower.training.settings import STRICT, Share
from follower_vision.images.frame import Image

_PIECE_PX = 96
_JPEG_QUALITY = 92
_LEAST_IN_FRAME = 0.3
_Side = Annotated[int, Field(ge=64)]


@dataclass(frozen=True, slots=True, config=STRICT)
class SceneSettings:
    """Sizes, motions and how often each difficulty occurs.

    Shares are of the scenes, 0 to 1; motions are standard deviations a frame.

    Attributes:
        width: of the frame in pixels.
        height: of the frame in pixels.
        least_scale: smallest target, the square root of its box's area in pixels.
        most_scale: the largest.
        motion: largest step of the target a frame, in its own scale.
        scale_change: largest step of log scale a frame.
        aspect_change: largest step of log aspect a frame.
        rotation: largest step of the target's rotation, radians a frame.
        perspective: share of scenes with a tilting target.
        deformation: share of scenes in which the target bends.
        occlusion: share with something passing before the target.
        look_alikes: share with copies of the target, or like things, beside it.
        leaving: share in which the target may leave the frame and return.
        blur: share with motion blur.
        low_light: share with strong changes of light.
        soft: share that is not quite in focus.
        grey: share in black and white.
        compression: share with the traces of a film's compression.
        turning: share with a target that turns in space, where there are such bodies.
        pieces: share in which the target is a piece of the ground itself, without an edge.
        loose: share in which the box does not fit the mask, as one that a user has drawn.
    """

    width: _Side = 640
    height: _Side = 480
    least_scale: Annotated[float, Field(ge=4)] = 14.0
    most_scale: float = 150.0
    motion: float = 0.3
    scale_change: float = 0.03
    aspect_change: float = 0.02
    rotation: float = 0.04
    perspective: Share = 0.3
    deformation: Share = 0.3
    occlusion: Share = 0.4
    look_alikes: Share = 0.6
    leaving: Share = 0.15
    blur: Share = 0.35
    low_light: Share = 0.5
    soft: Share = 0.5
    grey: Share = 0.15
    compression: Share = 0.5
    turning: Share = 0.0
    pieces: Share = 0.25
    loose: Share = 0.7

    def __post_init__(self) -> None:
        if self.most_scale < self.least_scale:
            raise ValueError("most_scale must be no smaller than least_scale")


@dataclasses.dataclass(frozen=True, slots=True)
class SceneMaker:
    """Makes scene number `index` of a seed, always the same one.

    Attributes:
        pictures: what scenes are made of.
        settings: how hard they are.
        seed: scenes of different seeds have nothing to do with one another.
    """

    pictures: ImageSource
    settings: SceneSettings
    seed: int

    def scene(self, index: int, frames: int) -> Scene:
        """Return scene `index`, of so many frames."""
        rng = np.random.default_rng((self.seed, index))
        return _Composer(rng, self.pictures, self.settings, frames).scene()


def write_sequence(scene: Scene, folder: Path) -> None:
    """Write img/000001.jpg and so on, and groundtruth.txt with x, y, width, height a line.

    Where most of the target is outside the frame, its line is 0,0,0,0. The boxes, in pixels, are
    those that a user would draw, the hidden parts of the target included.
    """
    (folder / "img").mkdir(parents=True, exist_ok=True)
    lines = []
    for frame in range(scene.frames):
        path = folder / "img" / f"{frame + 1:06}.jpg"
        cv2.imwrite(str(path), scene.whole(frame).image, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        box = scene.drawn_box(frame)
        inside = box.visible_share(scene.width, scene.height) >= _LEAST_IN_FRAME
        lines.append(",".join(f"{value:.2f}" for value in box.xywh) if inside else "0,0,0,0")
    (folder / "groundtruth.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


@dataclasses.dataclass(frozen=True, slots=True)
class _Composer:
    """Draws the random numbers of one scene."""

    rng: np.random.Generator
    pictures: ImageSource
    settings: SceneSettings
    frames: int

    def scene(self) -> Scene:
        settings, rng = self.settings, self.rng
        ground = self.pictures.any_ground(rng)
        camera = self._camera(ground)
        scale = float(np.exp(rng.uniform(*np.log([settings.least_scale, settings.most_scale]))))
        middle = self._middle(scale)
        target = self._target(ground, camera, scale, middle)
        behind, before = self._look_alikes(target, scale, middle, camera)
        layers = [*behind, target, *before, *self._occluders(scale, middle, camera)]
        light = self._light(middle)
        return Scene(
            ground,
            camera,
            tuple(layers),
            len(behind),
            light,
            settings.width,
            settings.height,
            self._looseness(),
        )

    def _looseness(self) -> tuple[float, float, float, float]:
        rng = self.rng
        if not self._chance(self.settings.loose):
            return 0.0, 0.0, 1.0, 1.0
        right, down = rng.normal(0.0, 0.08, 2)
        wider, taller = np.exp(rng.normal(0.0, 0.2, 2))
        return float(right), float(down), float(wider), float(taller)

    def _chance(self, share: float) -> bool:
        return bool(self.rng.uniform() < share)

    def _camera(self, ground: Image) -> Matrix:
        """Return (T, 3, 3) from the ground's pixels to the frame's."""
        rng, frames = self.rng, self.frames
        calm = rng.choice([0.0, 0.3, 1.0, 3.0])
        zoom = rng.uniform(0.6, 2.2) * np.exp(wander(rng, frames, 0.004 * calm, 0.9))
        turn = rng.normal(0, 0.3) + wander(rng, frames, 0.006 * calm, 0.9)
        shake = rng.choice([0.0, 0.5, 2.0])
        x, y = (
            wander(rng, frames, 2.5 * calm, 0.92) + hover(rng, frames, shake, 0.3) for _ in "xy"
        )
        height, width = ground.shape[:2]
        start = rng.uniform((0.0, 0.0), (width, height))
        looks = _similarity(
            zoom, turn, start, x + self.settings.width / 2, y + self.settings.height / 2
        )
        if self._chance(0.3):
            looks[:, 2, :2] = rng.normal(0, 1.5e-4, 2)
        return looks

    def _middle(self, scale: float) -> Matrix:
        """Return (T, 2) the middle of the target in the frame."""
        settings, rng = self.settings, self.rng
        step = scale * settings.motion * rng.uniform() ** 2
        memory = rng.uniform(0.3, 0.97)
        courses = []
        for size in (settings.width, settings.height):
            course = rng.uniform(0.1, 0.9) * size + wander(rng, self.frames, step, memory)
            course += hover(rng, self.frames, 0.1 * step, 0.2)
            margin = -scale if self._chance(settings.leaving) else 0.45 * scale
            courses.append(folded(course, margin, size - margin))
        return np.stack(courses, axis=1)

    def _target(self, ground: Image, camera: Matrix, scale: float, middle: Matrix) -> Layer:
        rng, settings, frames = self.rng, self.settings, self.frames
        if self._chance(settings.pieces):
            return _piece_of_ground(rng, ground, camera, scale, settings)
        if self.pictures.bodies and self._chance(settings.turning):
            return self._turning(scale, middle)
        cutout = self.pictures.any_object(rng)
        places = self._placed(cutout, scale, middle, settings.rotation)
        if self._chance(settings.perspective):
            tilts = np.stack([hover(rng, frames, 0.12, 0.95) for _ in "xy"], axis=1)
            places = _tilted(places, cutout, tilts)
        bends = self._chance(settings.deformation)
        return Layer(cutout, places, random_bending(rng, cutout, frames) if bends else None)

    def _turning(self, scale: float, middle: Matrix) -> Layer:
        """Return a body that drives, walks or flies, and turns."""
        rng, frames = self.rng, self.frames
        body = self.pictures.bodies[int(rng.integers(len(self.pictures.bodies)))]
        steady = rng.normal(0, 0.06) if self._chance(0.5) else 0.0
        headings = rng.uniform(0, 2 * np.pi) + steady * np.arange(frames)
        headings = headings + wander(rng, frames, 0.08 * rng.uniform() ** 2, 0.9)
        first = body.views[0]
        places = self._placed(first, scale / body.fill, middle, self.settings.rotation)
        return Layer(first, places, Turning(body, headings))

    def _placed(self, cutout: Cutout, scale: float, middle: Matrix, rotation: float) -> Matrix:
        """Return (T, 3, 3) for an object of about a scale along a way, growing and turning."""
        rng, settings, frames = self.rng, self.settings, self.frames
        growth = settings.scale_change * rng.uniform() ** 2
        log_scale = folded(wander(rng, frames, growth, 0.9), -0.9, 0.9)
        aspect = folded(wander(rng, frames, settings.aspect_change * rng.uniform(), 0.9), -0.5, 0.5)
        lean = rng.normal(0, 0.25) if self._chance(0.5) else rng.uniform(-np.pi, np.pi)
        turn = lean + wander(rng, frames, rotation * rng.uniform() ** 2, 0.9)
        width, height = cutout.size
        zoom = scale / np.sqrt(width * height) * np.exp(log_scale)
        places = _similarity(zoom, turn, (width / 2, height / 2), middle[:, 0], middle[:, 1])
        stretch = np.zeros((frames, 3, 3))
        stretch[:, 0, 0], stretch[:, 1, 1], stretch[:, 2, 2] = np.exp(aspect), np.exp(-aspect), 1.0
        stretch[:, 0, 2] = width / 2 * (1.0 - stretch[:, 0, 0])
        stretch[:, 1, 2] = height / 2 * (1.0 - stretch[:, 1, 1])
        return np.asarray(places @ stretch)

    def _look_alikes(
        self, target: Layer, scale: float, middle: Matrix, camera: Matrix
    ) -> tuple[list[Layer], list[Layer]]:
        """Return what goes behind and before the target: its like, or anything."""
        rng, settings = self.rng, self.settings
        behind: list[Layer] = []
        before: list[Layer] = []
        if not self._chance(settings.look_alikes):
            return behind, before
        for _ in range(int(rng.integers(1, 4))):
            kind = rng.uniform()
            cutout = target.cutout if kind < 0.4 else self.pictures.any_object(rng)
            if 0.4 <= kind < 0.7:
                cutout = _recoloured(rng, target.cutout)
            way = self._other_way(scale, middle, camera)
            size = scale * np.exp(rng.normal(0, 0.25))
            layer = Layer(cutout, self._placed(cutout, size, way, settings.rotation))
            (before if self._chance(0.3) else behind).append(layer)
        return behind, before

    def _other_way(self, scale: float, middle: Matrix, camera: Matrix) -> Matrix:
        """Return (T, 2) a way that passes the target or goes beside it."""
        rng, frames = self.rng, self.frames
        offset = rng.normal(0, 1.0, 2)
        offset *= scale * rng.uniform(0.9, 2.5) / max(float(np.hypot(*offset)), 1e-6)
        step = scale * 0.15 * rng.uniform()
        own = np.stack([wander(rng, frames, step, 0.95) for _ in "xy"], axis=1)
        if self._chance(0.5):
            return middle + offset + own
        return _anchored(camera, middle, int(rng.integers(frames))) + offset + own

    def _occluders(self, scale: float, middle: Matrix, camera: Matrix) -> list[Layer]:
        """Return things that stand before the target's way, on the ground or moving."""
        rng, layers = self.rng, []
        if self._chance(self.settings.occlusion):
            for _ in range(int(rng.integers(1, 3))):
                frame = int(rng.integers(self.frames))
                way = _anchored(camera, middle, frame) + rng.normal(0, 0.3 * scale, 2)
                drift = rng.normal(0, 0.08 * scale, 2)
                way = way + (np.arange(self.frames) - frame)[:, None] * drift
                cutout = self.pictures.any_object(rng)
                size = scale * float(np.exp(rng.uniform(-1.0, 0.7)))
                layers.append(Layer(cutout, self._placed(cutout, size, way, 0.01)))
        return layers

    def _light(self, middle: Matrix) -> Light:
        rng, frames = self.rng, self.frames
        strength = 0.5 if self._chance(self.settings.low_light) else 0.1
        level = np.exp(rng.normal(0, 0.5 * strength) + hover(rng, frames, 0.2 * strength, 0.95))
        tint = np.exp(rng.normal(0, 0.1, 3))
        offset = rng.normal(0, 20 * strength) + hover(rng, frames, 10 * strength, 0.95)
        noise = float(rng.choice([0.5, 2.0, 6.0]))
        way = self._blur(middle)
        seed = int(rng.integers(1 << 31))
        soft = float(rng.uniform(0.4, 1.5)) if self._chance(self.settings.soft) else 0.0
        grey = self._chance(self.settings.grey)
        quality = int(rng.integers(15, 80)) if self._chance(self.settings.compression) else None
        return Light(level[:, None] * tint, offset, noise, way, seed, soft, grey, quality)

    def _blur(self, middle: Matrix) -> npt.NDArray[np.float64]:
        """Return (T, 2) the way smeared: a share of the motion, or a burst."""
        rng, frames = self.rng, self.frames
        way = np.zeros((frames, 2))
        if self._chance(self.settings.blur):
            way[1:] = np.diff(middle, axis=0) * rng.uniform(0.2, 1.0)
            burst = rng.normal(0, rng.uniform(1, 10), 2)
            start = int(rng.integers(frames))
            way[start : start + int(rng.integers(1, 6))] += burst
        return way


def _similarity(zoom: Course, turn: Course, pivot: npt.ArrayLike, x: Course, y: Course) -> Matrix:
    """Return (T, 3, 3): scale and turn about a pivot, which goes to (x, y)."""
    cosine, sine = zoom * np.cos(turn), zoom * np.sin(turn)
    px, py = np.asarray(pivot, dtype=float)
    matrices = np.zeros((len(x), 3, 3))
    matrices[:, 0, 0], matrices[:, 0, 1] = cosine, -sine
    matrices[:, 1, 0], matrices[:, 1, 1] = sine, cosine
    matrices[:, 0, 2] = x - cosine * px + sine * py
    matrices[:, 1, 2] = y - sine * px - cosine * py
    matrices[:, 2, 2] = 1.0
    return matrices


def _anchored(camera: Matrix, middle: Matrix, frame: int) -> Matrix:
    """Return (T, 2) the way of the ground's point that lies under the target in a frame."""
    point = np.linalg.solve(camera[frame], [*middle[frame], 1.0])
    seen = camera @ point
    return np.asarray(seen[:, :2] / seen[:, 2:])


def _tilted(places: Matrix, cutout: Cutout, tilts: Matrix) -> Matrix:
    """Return places with a perspective about the object's middle."""
    width, height = cutout.size
    tilt = np.tile(np.eye(3), (len(places), 1, 1))
    tilt[:, 2, :2] = tilts / (width, height)
    to_middle = stretch_and_shift(1, 1, -width / 2, -height / 2)
    return np.asarray(places @ np.linalg.inv(to_middle) @ tilt @ to_middle)


def _recoloured(rng: np.random.Generator, cutout: Cutout) -> Cutout:
    """Return the same shape in other colours."""
    mix = np.eye(3) * 0.3 + 0.7 * rng.dirichlet(np.ones(3), 3)
    picture = cutout.levels[0].copy()
    colours = np.clip(picture[:, :, :3] @ mix.T * rng.uniform(0.6, 1.4), 0, 255)
    picture[:, :, :3] = np.minimum(colours, picture[:, :, 3:])
    return Cutout.premultiplied(picture)


def _piece_of_ground(
    rng: np.random.Generator, ground: Image, camera: Matrix, scale: float, settings: SceneSettings
) -> Layer:
    """Return a target that is part of the ground: it moves with the camera alone."""
    aspect = np.exp(rng.uniform(-0.7, 0.7))
    at = np.array([settings.width, settings.height]) * rng.uniform(0.25, 0.75, 2)
    zoom = np.sqrt(abs(np.linalg.det(camera[0][:2, :2])))
    size = np.array([scale * aspect, scale / aspect]) / zoom
    middle = np.linalg.solve(camera[0], [*at, 1.0])
    middle = middle[:2] / middle[2]
    to_ground = stretch_and_shift(*size / _PIECE_PX, *middle - size / 2)
    picture = cv2.warpAffine(
        ground,
        to_ground[:2],
        (_PIECE_PX, _PIECE_PX),
        flags=cv2.INTER_AREA | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REFLECT_101,
    )
    mask = random_mask(rng, _PIECE_PX, _PIECE_PX)
    return Layer(Cutout.of(cut(np.asarray(picture, np.uint8), mask)), camera @ to_ground)
