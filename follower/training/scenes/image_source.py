"""What scenes are made of: photographs and cut-outs, or procedural pictures alone."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image

Mask = npt.NDArray[np.uint8]
Matrix: TypeAlias = npt.NDArray[np.float64]

_LEAST_RADIUS_PX = 4.0
_FINER = 4
_SOLID = 127
_LEAST_LEVEL_PX = 12
_TEXTURES = 24
_TEXTURE_PX = 512
_PHOTOGRAPHS_SHARE = 0.75
_CUTOUTS_SHARE = 0.5


def noise_texture(rng: np.random.Generator, side: int) -> Image:
    """Return coloured noise (side, side, 3) whose spectrum falls like that of photographs."""
    total = np.zeros((side, side, 3), np.float32)
    roughness = rng.uniform(0.45, 0.8)
    cells, weight = 4, 1.0
    while cells <= side:
        coarse = rng.normal(size=(cells, cells, 3)).astype(np.float32)
        total += weight * cv2.resize(coarse, (side, side), interpolation=cv2.INTER_CUBIC)
        cells, weight = cells * 2, weight * roughness
    grey = total.mean(axis=2, keepdims=True)
    total = grey + rng.uniform(0.1, 0.8) * (total - grey)
    spread = rng.uniform(20.0, 60.0) / max(float(total.std()), 1e-6)
    return _picture(total * spread + rng.uniform(70, 180, 3))


def leaves_texture(rng: np.random.Generator, side: int, count: int = 250) -> Image:
    """Return a picture (side, side, 3) of shapes that hide one another.

    Such "dead leaves" have the edges and scales of photographs (Ruderman, "Origins of scaling in
    natural images", 1997) and teach a network almost as well (Baradad et al., "Learning to see by
    looking at noise", NeurIPS 2021).
    """
    canvas = noise_texture(rng, side)
    for radius in np.sort(_radii(rng, side, count))[::-1]:
        colour = tuple(float(value) for value in rng.uniform(0, 255, 3))
        points = _leaf(rng, radius) + rng.uniform(0, side, 2)
        cv2.fillPoly(canvas, [points.astype(np.int32)], colour, cv2.LINE_AA)
    grain = rng.normal(0.0, rng.uniform(0.0, 12.0), canvas.shape)
    return _picture(canvas + grain)


def stripes_texture(rng: np.random.Generator, side: int) -> Image:
    """Return stripes or checks (side, side, 3): the hardest ground to find a place on."""
    along = np.arange(side, dtype=np.float32)
    period = rng.uniform(8, 48, 2)
    across = np.sin(2 * np.pi * along / period[0])[None, :]
    down = np.sin(2 * np.pi * along / period[1])[:, None] * float(rng.uniform() < 0.5)
    share = 1.0 / (1.0 + np.exp(-4.0 * (across + down)))
    first, second = rng.uniform(0, 255, (2, 3))
    picture = share[:, :, None] * first + (1.0 - share[:, :, None]) * second
    return _picture(0.7 * picture + 0.3 * noise_texture(rng, side))


def _picture(values: npt.ArrayLike) -> Image:
    return np.asarray(np.clip(np.asarray(values), 0, 255), dtype=np.uint8)


def _radii(rng: np.random.Generator, side: int, count: int) -> npt.NDArray[np.float64]:
    """Return radii whose density falls with the third power, as scale invariance asks."""
    least, most = _LEAST_RADIUS_PX, side / 3
    share = rng.uniform(size=count)
    return 1.0 / np.sqrt(share / least**2 + (1.0 - share) / most**2)


def _leaf(rng: np.random.Generator, radius: float) -> npt.NDArray[np.float64]:
    """Return the corners (K, 2) of an ellipse or a polygon about zero."""
    corners = int(rng.choice([3, 4, 4, 5, 24, 24]))
    angles = np.linspace(0.0, 2 * np.pi, corners, endpoint=False) + rng.uniform(0, 2 * np.pi)
    squeeze = rng.uniform(0.3, 1.0)
    points = radius * np.stack([np.cos(angles), squeeze * np.sin(angles)], axis=1)
    turn = rng.uniform(0, np.pi)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return np.asarray(points @ rotation.T)


def random_mask(rng: np.random.Generator, width: int, height: int) -> Mask:
    """Return a mask (height, width) uint8 of a random shape that fills its rectangle."""
    kinds = (_rectangle, _ellipse, _blob, _blob, _polygon, _stack)
    mask = kinds[int(rng.integers(len(kinds)))](rng, width * _FINER, height * _FINER)
    return np.asarray(cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA), np.uint8)


def cut(picture: Image, mask: Mask) -> npt.NDArray[np.uint8]:
    """Return (H, W, 4): a picture (H, W, 3) with a mask (H, W)."""
    return np.dstack([picture, mask]).astype(np.uint8)


def _rectangle(_rng: np.random.Generator, width: int, height: int) -> Mask:
    return np.full((height, width), 255, np.uint8)


def _ellipse(_rng: np.random.Generator, width: int, height: int) -> Mask:
    mask = np.zeros((height, width), np.uint8)
    return _filled_ellipse(mask, (width / 2, height / 2), (width / 2 - 1, height / 2 - 1))


def _blob(rng: np.random.Generator, width: int, height: int) -> Mask:
    """Return a smooth closed curve: a circle whose radius varies with the angle."""
    angles = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
    radius = np.ones_like(angles)
    for harmonic in range(2, 6):
        phase, size = rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.5 / harmonic)
        radius += size * np.cos(harmonic * angles + phase)
    return _filled(np.stack([radius * np.cos(angles), radius * np.sin(angles)], 1), width, height)


def _polygon(rng: np.random.Generator, width: int, height: int) -> Mask:
    angles = np.sort(rng.uniform(0, 2 * np.pi, int(rng.integers(4, 9))))
    radius = rng.uniform(0.6, 1.0, angles.size)
    return _filled(np.stack([radius * np.cos(angles), radius * np.sin(angles)], 1), width, height)


def _stack(rng: np.random.Generator, width: int, height: int) -> Mask:
    """Return ellipses one above the other, as a head, a body and legs are."""
    mask = np.zeros((height, width), np.uint8)
    parts = int(rng.integers(2, 5))
    for index in range(parts):
        middle = (width * rng.uniform(0.4, 0.6), height * (index + 0.5) / parts)
        _filled_ellipse(mask, middle, (width * rng.uniform(0.2, 0.5), height * 0.7 / parts))
    return mask


def _filled_ellipse(mask: Mask, middle: tuple[float, float], half: tuple[float, float]) -> Mask:
    size = (round(2 * half[0]), round(2 * half[1]))
    cv2.ellipse(mask, (middle, size, 0.0), 255, cv2.FILLED)
    return mask


def _filled(points: npt.NDArray[np.float64], width: int, height: int) -> Mask:
    """Fill a closed curve stretched to the whole rectangle."""
    points = points - points.min(axis=0)
    points = points / points.max(axis=0) * (width - 1, height - 1)
    mask = np.zeros((height, width), np.uint8)
    cv2.fillPoly(mask, [np.round(points).astype(np.int32)], 255)
    return mask


@dataclass(frozen=True, slots=True, eq=False)
class Cutout:
    """A flat object with a soft mask.

    Attributes:
        levels: (H, W, 4) uint8 blue, green, red (multiplied by the mask) and mask; each level has
            half the side of the one before it.
        outline: (K, 2) corners of the mask's convex hull in the first level's pixels, from the
            corner of its top-left pixel.
    """

    levels: tuple[npt.NDArray[np.uint8], ...]
    outline: Matrix

    @classmethod
    def of(cls, picture: npt.NDArray[np.uint8]) -> Cutout:
        """Make a cut-out of (H, W, 4) uint8 with colours not yet multiplied by the mask.

        Raises:
            ValueError: nothing of it is solid.
        """
        mask = picture[:, :, 3]
        colours = cv2.multiply(picture[:, :, :3], cv2.merge([mask] * 3), scale=1 / 255)
        return cls.premultiplied(np.dstack([colours, mask]).astype(np.uint8))

    @classmethod
    def premultiplied(cls, picture: npt.NDArray[np.uint8]) -> Cutout:
        """Make a cut-out of (H, W, 4) uint8 whose colours are multiplied by the mask.

        Raises:
            ValueError: nothing of it is solid.
        """
        levels = [picture]
        while min(levels[-1].shape[:2]) >= 2 * _LEAST_LEVEL_PX:
            height, width = levels[-1].shape[:2]
            smaller = cv2.resize(
                levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA
            )
            levels.append(np.asarray(smaller, dtype=np.uint8))
        return cls(tuple(levels), mask_outline(picture[:, :, 3]))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the first level in pixels."""
        height, width = self.levels[0].shape[:2]
        return width, height

    def box(self, placement: Matrix) -> Box:
        """Return the box, in pixels of the frame, about the mask placed by `placement`, (3, 3)."""
        points = self.outline @ placement[:, :2].T + placement[:, 2]
        points = points[:, :2] / points[:, 2:]
        left, top = points.min(axis=0)
        right, bottom = points.max(axis=0)
        return Box.from_xywh(left, top, right - left, bottom - top)

    def draw(
        self, canvas: npt.NDArray[np.uint8], placement: Matrix
    ) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
        """Return the canvas (H, W, 3) with the object on it, and the object's mask (H, W).

        Args:
            canvas: what lies behind; it is left as it is.
            placement: (3, 3) from the cut-out's pixels to the canvas's, corner to corner.
        """
        height, width = canvas.shape[:2]
        level, matrix = self._level(placement)
        warped = warp(level, matrix, width, height, cv2.BORDER_CONSTANT)
        mask = np.ascontiguousarray(warped[:, :, 3])
        if not mask.any():
            return canvas, mask
        behind = cv2.multiply(canvas, cv2.merge([255 - mask] * 3), scale=1 / 255)
        return np.asarray(cv2.add(behind, warped[:, :, :3]), dtype=np.uint8), mask

    def _level(self, placement: Matrix) -> tuple[npt.NDArray[np.uint8], Matrix]:
        (a, b), (c, d) = placement[:2, :2].tolist()
        scale = math.sqrt(abs(a * d - b * c)) / abs(placement[2, 2])
        wanted = math.floor(-math.log2(max(scale, 1e-6)))
        level = self.levels[min(max(wanted, 0), len(self.levels) - 1)]
        width, height = self.size
        enlarge = np.diag([width / level.shape[1], height / level.shape[0], 1.0])
        return level, placement @ enlarge


def stretch_and_shift(across: float, down: float, x: float = 0.0, y: float = 0.0) -> Matrix:
    """Return (3, 3): stretch by two factors, then shift by (x, y)."""
    return np.array([[across, 0.0, x], [0.0, down, y], [0.0, 0.0, 1.0]])


def warp(
    picture: npt.NDArray[np.uint8], placement: Matrix, width: int, height: int, border: int
) -> npt.NDArray[np.uint8]:
    """Return a picture as `placement`, (3, 3), puts it on a canvas; corners go to corners."""
    half, back = stretch_and_shift(1, 1, 0.5, 0.5), stretch_and_shift(1, 1, -0.5, -0.5)
    matrix = back @ placement @ half
    size, how = (width, height), cv2.INTER_LINEAR
    if matrix[2, 0] == 0.0 and matrix[2, 1] == 0.0:
        affine = matrix[:2] / matrix[2, 2]
        out = cv2.warpAffine(picture, affine, size, flags=how, borderMode=border)
    else:
        out = cv2.warpPerspective(picture, matrix, size, flags=how, borderMode=border)
    return np.asarray(out, dtype=np.uint8)


def mask_outline(mask: npt.NDArray[np.uint8]) -> Matrix:
    """Return the convex hull (K, 2) of a mask's solid pixels, corners included.

    Raises:
        ValueError: no pixel is solid.
    """
    _, solid = cv2.threshold(mask, _SOLID, 255, cv2.THRESH_BINARY)
    edges, _ = cv2.findContours(solid, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    if not edges:
        raise ValueError("a cut-out needs a solid part")
    hull = cv2.convexHull(np.concatenate(edges)).reshape(-1, 2).astype(np.float64)
    corners = [hull + step for step in ((0, 0), (1, 0), (0, 1), (1, 1))]
    return np.concatenate(corners)


@dataclass(frozen=True, slots=True, eq=False)
class TurningBody:
    """An object from all sides, at one elevation.

    Attributes:
        views: cut-outs on canvases of one size about its middle, in equal steps of a full turn.
    """

    views: tuple[Cutout, ...]

    @property
    def fill(self) -> float:
        """Mean scale of its box over that of the canvas."""
        scales = [view.box(np.eye(3)).scale for view in self.views]
        width, height = self.views[0].size
        return float(np.mean(scales)) / math.sqrt(width * height)


@dataclass(frozen=True, slots=True, eq=False)
class ImageSource:
    """The stock that scenes draw from.

    Attributes:
        photographs: (H, W, 3) uint8 each, no side shorter than 128 pixels.
        textures: procedural ones, likewise.
        cutouts: objects with masks.
        bodies: objects seen from all sides.
    """

    photographs: tuple[Image, ...]
    textures: tuple[Image, ...]
    cutouts: tuple[Cutout, ...]
    bodies: tuple[TurningBody, ...] = ()

    def joined(self, other: ImageSource) -> ImageSource:
        """Return this stock and another one together."""
        return ImageSource(
            self.photographs + other.photographs,
            self.textures + other.textures,
            self.cutouts + other.cutouts,
            self.bodies + other.bodies,
        )

    def any_ground(self, rng: np.random.Generator) -> Image:
        """Return a photograph, or sometimes a procedural texture, (H, W, 3) uint8 BGR."""
        stock = self.textures
        if self.photographs and rng.uniform() < _PHOTOGRAPHS_SHARE:
            stock = self.photographs
        return stock[int(rng.integers(len(stock)))]

    def any_object(self, rng: np.random.Generator) -> Cutout:
        """Return a ready cut-out, or a piece of a photograph of 16 to 128 pixels a side."""
        if self.cutouts and rng.uniform() < _CUTOUTS_SHARE:
            return self.cutouts[int(rng.integers(len(self.cutouts)))]
        return _piece(rng, self.any_ground(rng))


def procedural(rng: np.random.Generator, count: int = _TEXTURES) -> ImageSource:
    """Return a stock that needs no file."""
    kinds = (noise_texture, leaves_texture, leaves_texture, stripes_texture)
    chosen = (kinds[int(rng.integers(len(kinds)))] for _ in range(count))
    return ImageSource((), tuple(texture(rng, _TEXTURE_PX) for texture in chosen), ())


def _piece(rng: np.random.Generator, ground: Image) -> Cutout:
    """Cut a piece of random place, size, shape and tint out of a photograph."""
    long = int(rng.integers(32, 129))
    short = max(16, int(long * rng.uniform(0.3, 1.0)))
    width, height = (long, short) if rng.uniform() < 0.5 else (short, long)
    left = int(rng.integers(ground.shape[1] - width + 1))
    top = int(rng.integers(ground.shape[0] - height + 1))
    picture = ground[top : top + height, left : left + width]
    tinted = rng.uniform(0.6, 1.4, 3) * picture + rng.uniform(-40, 40, 3)
    return Cutout.of(cut(np.clip(tinted, 0, 255).astype(np.uint8), random_mask(rng, width, height)))
