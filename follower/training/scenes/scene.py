"""One generated sequence: what stands where in each frame, drawn on demand."""

from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from follower.training.detector.labelled_image import motion_blurred
from follower.training.scenes.image_source import (
    Cutout,
    Matrix,
    TurningBody,
    stretch_and_shift,
    warp,
)
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image

Course = npt.NDArray[np.float64]

LEAST_VISIBLE = 0.3
"""A target of which less is to be seen counts as hidden."""
_LEAST_SIDE_PX = 3.0
_SOFT_LEAST_PX = 0.3
_GRAIN = np.random.default_rng(0).standard_normal((331, 331, 3), dtype=np.float32)


def bounded(box: Box) -> Box:
    """Return a box no smaller than a tracker allows, 3 pixels a side."""
    return Box(box.cx, box.cy, max(box.width, _LEAST_SIDE_PX), max(box.height, _LEAST_SIDE_PX))


class Deformation:
    """A smooth displacement of an object's pixels that swings over time."""

    def __init__(
        self,
        cutout: Cutout,
        fields: npt.NDArray[np.float32],
        swings: npt.NDArray[np.float64],
    ) -> None:
        """Make a bending.

        Args:
            cutout: the object at rest.
            fields: (2, H, W, 2) two displacements at full swing, in the object's pixels.
            swings: (T, 2) how far each is swung in each frame.
        """
        self.cutout = cutout
        self.fields = fields
        self.swings = swings
        self.bent = lru_cache(maxsize=2)(self._bent)

    def _bent(self, frame: int) -> Cutout:
        """Return the object's shape in a frame."""
        picture = self.cutout.levels[0]
        height, width = picture.shape[:2]
        columns, rows = np.meshgrid(
            np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)
        )
        first, second = (np.float32(swing) for swing in self.swings[frame])
        shift = first * self.fields[0] + second * self.fields[1]
        bent = cv2.remap(
            picture,
            columns + shift[:, :, 0],
            rows + shift[:, :, 1],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
        )
        return Cutout.premultiplied(np.asarray(bent, dtype=np.uint8))


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """A body that turns over time.

    Attributes:
        body: what turns.
        headings: (T,) in radians.
    """

    body: TurningBody
    headings: Course

    def bent(self, frame: int) -> Cutout:
        """Return the object's look in a frame."""
        count = len(self.body.views)
        number = round(float(self.headings[frame]) / (2 * np.pi) * count)
        return self.body.views[number % count]


def random_bending(rng: np.random.Generator, cutout: Cutout, frames: int) -> Deformation:
    """Return a bending for an object, at most a few tenths of its size."""
    width, height = cutout.size
    most = rng.uniform(0.03, 0.15) * min(width, height)
    coarse = rng.normal(0.0, 1.0, (2, 4, 4, 2)).astype(np.float32)
    fields = [
        most * cv2.resize(field, (width, height), interpolation=cv2.INTER_CUBIC) for field in coarse
    ]
    time = np.arange(frames)
    speeds, phases = rng.uniform(0.05, 0.5, 2), rng.uniform(0, 2 * np.pi, 2)
    swings = np.sin(time[:, None] * speeds + phases)
    return Deformation(cutout, np.stack(fields).astype(np.float32), swings)


def wander(rng: np.random.Generator, frames: int, step: float, memory: float) -> Course:
    """Return (frames,) a course from zero whose speed is an Ornstein-Uhlenbeck process.

    Args:
        rng: the source of chance.
        frames: how many.
        step: standard deviation of the change from frame to frame.
        memory: 0 to 1, how much of the speed is kept from frame to frame.
    """
    speed = np.empty(frames)
    speed[0] = 0.0
    last = rng.normal() * step
    kicks = rng.normal(size=frames) * step * np.sqrt(1.0 - memory**2)
    for frame in range(1, frames):
        last = memory * last + kicks[frame]
        speed[frame] = last
    return np.cumsum(speed)


def hover(rng: np.random.Generator, frames: int, spread: float, memory: float) -> Course:
    """Return (frames,) a course about zero with a standard deviation, that does not run away."""
    course = np.empty(frames)
    last = rng.normal() * spread
    kicks = rng.normal(size=frames) * spread * np.sqrt(1.0 - memory**2)
    for frame in range(frames):
        course[frame] = last
        last = memory * last + kicks[frame]
    return course


def folded(course: Course, least: float, most: float) -> Course:
    """Reflect a course (frames,) at two limits of its own unit."""
    span = max(most - least, 1e-9)
    phase = np.mod(course - least, 2 * span)
    return least + np.where(phase > span, 2 * span - phase, phase)


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """An object and where it is.

    Attributes:
        cutout: how it looks.
        places: (T, 3, 3) from its pixels to the frame's.
        bending: how it changes its shape, if it does.
    """

    cutout: Cutout
    places: Matrix
    bending: Deformation | Turning | None = None

    def shape(self, frame: int) -> Cutout:
        """Return how it looks in a frame."""
        return self.cutout if self.bending is None else self.bending.bent(frame)

    def box(self, frame: int) -> Box:
        """Return the box about its mask, whether hidden or not."""
        return self.shape(frame).box(self.places[frame])


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """What the camera makes of the light.

    Attributes:
        gain: (T, 3) factor of each colour.
        offset: (T,) added to all.
        noise: standard deviation of each pixel.
        blur: (T, 2) way of the picture during the exposure, in frame pixels.
        seed: of the noise.
        soft: standard deviation of the lens's blur, in frame pixels.
        grey: whether the film is black and white.
        quality: of the JPEG compression, 0 to 100; None leaves it out.
    """

    gain: npt.NDArray[np.float64]
    offset: npt.NDArray[np.float64]
    noise: float
    blur: npt.NDArray[np.float64]
    seed: int
    soft: float = 0.0
    grey: bool = False
    quality: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A part of a frame as the camera sees it.

    Attributes:
        image: (h, w, 3) uint8.
        visible: share of the target's mask within it that nothing hides; 0 if none is within it.
        mask: (h, w) uint8 of the target, hidden parts included.
    """

    image: Image
    visible: float
    mask: npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A sequence of `frames` frames with one target.

    Attributes:
        ground: the picture behind everything.
        ground_places: (T, 3, 3) from its pixels to the frame's.
        layers: back to front.
        target: which layer.
        light: of each frame.
        width: of the frame in pixels.
        height: of the frame in pixels.
        looseness: how a user's box differs from the one that fits the mask, the same in all
            frames: shift right and down in the fitting box's sides, and factors of both sides.
    """

    ground: Image
    ground_places: Matrix
    layers: tuple[Layer, ...]
    target: int
    light: Light
    width: int
    height: int
    looseness: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)
    fill: tuple[float, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "fill", tuple(cv2.mean(self.ground)[:3]))

    @property
    def frames(self) -> int:
        """How many frames there are."""
        return len(self.ground_places)

    def box(self, frame: int) -> Box:
        """Return the target's box in the frame's pixels, hidden or outside parts included."""
        return self.layers[self.target].box(frame)

    def drawn_box(self, frame: int) -> Box:
        """Return the target's box as a user who is not too exact would draw it."""
        box, (right, down, wider, taller) = self.box(frame), self.looseness
        cx, cy = box.cx + right * box.width, box.cy + down * box.height
        return Box(cx, cy, box.width * wider, box.height * taller)

    def whole(self, frame: int) -> Shot:
        """Return a whole frame at its own size in pixels."""
        region = Box(self.width / 2, self.height / 2, self.width, self.height)
        return self.shot(frame, region, self.width, self.height)

    def crop(self, frame: int, region: Box, side: int) -> Shot:
        """Return a square region at `side` pixels, without drawing the rest of the frame.

        What the frame resolves less finely than the crop is drawn at the frame's resolution and
        enlarged, as a crop of a real frame would be.
        """
        native = int(np.clip(np.ceil(region.width), 8, side))
        shot = self.shot(frame, region, native, native)
        if native == side:
            return shot
        image = cv2.resize(shot.image, (side, side), interpolation=cv2.INTER_LINEAR)
        mask = cv2.resize(shot.mask, (side, side), interpolation=cv2.INTER_LINEAR)
        return Shot(np.asarray(image, np.uint8), shot.visible, np.asarray(mask, np.uint8))

    def shot(self, frame: int, region: Box, width: int, height: int) -> Shot:
        """Return a region of a frame at `width` x `height` pixels."""
        view = stretch_and_shift(
            width / region.width,
            height / region.height,
            -region.left * width / region.width,
            -region.top * height / region.height,
        )
        place = view @ self.ground_places[frame]
        canvas = warp(self.ground, place, width, height, cv2.BORDER_REFLECT_101)
        hidden = np.zeros((height, width), np.uint8)
        target = hidden
        for index, layer in enumerate(self.layers):
            canvas, mask = layer.shape(frame).draw(canvas, view @ layer.places[frame])
            if index == self.target:
                target = mask
            elif index > self.target:
                hidden = np.maximum(hidden, mask)
        inside = self._inside(view, width, height)
        area = float(target.sum(dtype=np.int64))
        seen = cv2.multiply(target, 255 - hidden, scale=1 / 255) * inside
        visible = float(seen.sum(dtype=np.int64)) / area if area else 0.0
        return Shot(self._exposed(canvas, frame, view, inside, region), visible, target)

    def _inside(self, view: Matrix, width: int, height: int) -> npt.NDArray[np.bool_]:
        """Return which pixels of the region lie in the frame, (h, w)."""
        left, top = view[0, 2], view[1, 2]
        right, bottom = left + self.width * view[0, 0], top + self.height * view[1, 1]
        across, down = np.arange(width) + 0.5, np.arange(height) + 0.5
        columns = (across >= left) & (across < right)
        rows = (down >= top) & (down < bottom)
        return np.asarray(rows[:, None] & columns[None, :])

    def _exposed(
        self,
        canvas: Image,
        frame: int,
        view: Matrix,
        inside: npt.NDArray[np.bool_],
        region: Box,
    ) -> Image:
        light = self.light
        soft = light.soft * view[0, 0]
        if soft >= _SOFT_LEAST_PX:
            canvas = np.asarray(cv2.GaussianBlur(canvas, (0, 0), soft), dtype=np.uint8)
        canvas = motion_blurred(canvas, light.blur[frame] * (view[0, 0], view[1, 1]))
        where = light.seed + 7919 * frame + 31 * round(region.left) + 17 * round(region.top)
        grain = _grain(where, *canvas.shape[:2]) * np.float32(light.noise)
        lit = canvas * light.gain[frame].astype(np.float32)
        lit += grain + np.float32(light.offset[frame])
        film = _filmed(np.asarray(np.clip(lit, 0, 255), dtype=np.uint8), light)
        fill = np.clip(self.fill, 0, 255).astype(np.uint8)
        return np.where(inside[:, :, None], film, fill)


def _filmed(image: Image, light: Light) -> Image:
    """Return what is left of a picture in a film."""
    if light.grey:
        image = np.asarray(
            cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
        )
    if light.quality is not None:
        _, data = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, light.quality))
        image = np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)
    return image


def _grain(where: int, height: int, width: int) -> npt.NDArray[np.float32]:
    """Return normal noise (height, width, 3): one fixed field, shifted and repeated."""
    spare = len(_GRAIN) - 1
    across, down = where % spare, (where // spare) % spare
    repeats = (-(-(down + height) // len(_GRAIN)), -(-(across + width) // len(_GRAIN)), 1)
    tiled = _GRAIN if repeats == (1, 1, 1) else np.tile(_GRAIN, repeats)
    return tiled[down : down + height, across : across + width]
