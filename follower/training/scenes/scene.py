"""One generated sequence: what stands where in each frame, drawn on demand."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt

from follower.training.scenes.bending import Bending
from follower.training.scenes.cutout import Cutout, Matrix, warp
from follower_vision.box import Box
from follower_vision.frame import Image

_BLUR_LEAST_PX = 1.5
_BLUR_MOST_PX = 31
_SOFT_LEAST_PX = 0.3
_GRAIN = np.random.default_rng(0).standard_normal((331, 331, 3), dtype=np.float32)


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
    bending: Bending | None = None

    def shape(self, frame: int) -> Cutout:
        """Return how it looks in a frame."""
        return self.cutout if self.bending is None else self.bending.bent(self.cutout, frame)

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
        """Return a whole frame."""
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
        view = np.array(
            [
                [width / region.width, 0.0, -region.left * width / region.width],
                [0.0, height / region.height, -region.top * height / region.height],
                [0.0, 0.0, 1.0],
            ]
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
        visible = _share(target, hidden, inside)
        return Shot(self._exposed(canvas, frame, view, inside, region), visible, target)

    def _inside(self, view: Matrix, width: int, height: int) -> npt.NDArray[np.bool_] | None:
        """Return which pixels of the region lie in the frame, (h, w); None if all do."""
        left, top = view[0, 2], view[1, 2]
        right, bottom = left + self.width * view[0, 0], top + self.height * view[1, 1]
        if left <= 0 and top <= 0 and right >= width and bottom >= height:
            return None
        across, down = np.arange(width) + 0.5, np.arange(height) + 0.5
        columns = (across >= left) & (across < right)
        rows = (down >= top) & (down < bottom)
        return np.asarray(rows[:, None] & columns[None, :])

    def _exposed(
        self,
        canvas: Image,
        frame: int,
        view: Matrix,
        inside: npt.NDArray[np.bool_] | None,
        region: Box,
    ) -> Image:
        light = self.light
        canvas = _softened(canvas, light.soft * view[0, 0])
        canvas = _blurred(canvas, light.blur[frame] * (view[0, 0], view[1, 1]))
        where = light.seed + 7919 * frame + 31 * round(region.left) + 17 * round(region.top)
        grain = _grain(where, *canvas.shape[:2]) * np.float32(light.noise)
        lit = canvas * light.gain[frame].astype(np.float32)
        lit += grain + np.float32(light.offset[frame])
        film = _filmed(np.asarray(np.clip(lit, 0, 255), dtype=np.uint8), light)
        if inside is None:
            return film
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


def _softened(canvas: Image, sigma: float) -> Image:
    """Blur a picture as a lens does that is not quite in focus; `sigma` in its own pixels."""
    if sigma < _SOFT_LEAST_PX:
        return canvas
    return np.asarray(cv2.GaussianBlur(canvas, (0, 0), sigma), dtype=np.uint8)


def _grain(where: int, height: int, width: int) -> npt.NDArray[np.float32]:
    """Return normal noise (height, width, 3): one fixed field, shifted and repeated."""
    spare = len(_GRAIN) - 1
    across, down = where % spare, (where // spare) % spare
    repeats = (-(-(down + height) // len(_GRAIN)), -(-(across + width) // len(_GRAIN)), 1)
    tiled = _GRAIN if repeats == (1, 1, 1) else np.tile(_GRAIN, repeats)
    return tiled[down : down + height, across : across + width]


def _share(
    target: npt.NDArray[np.uint8],
    hidden: npt.NDArray[np.uint8],
    inside: npt.NDArray[np.bool_] | None,
) -> float:
    whole = float(target.sum(dtype=np.int64))
    if whole == 0.0:
        return 0.0
    seen = cv2.multiply(target, 255 - hidden, scale=1 / 255)
    if inside is not None:
        seen = seen * inside
    return float(seen.sum(dtype=np.int64)) / whole


def _blurred(canvas: Image, way: npt.NDArray[np.float64]) -> Image:
    """Smear a picture along the way that it moved, in its own pixels."""
    length = float(np.hypot(*way))
    if length < _BLUR_LEAST_PX:
        return canvas
    way = way * min(1.0, _BLUR_MOST_PX / length)
    side = 2 * int(np.ceil(np.abs(way).max() / 2)) + 1
    kernel = np.zeros((side, side), np.float32)
    middle = np.array([side // 2, side // 2])
    first, last = (np.round(16 * (middle + sign * way / 2)).astype(int) for sign in (-1, 1))
    cv2.line(kernel, first.tolist(), last.tolist(), 1.0, 1, cv2.LINE_AA, 4)
    return np.asarray(cv2.filter2D(canvas, -1, kernel / kernel.sum()), dtype=np.uint8)
