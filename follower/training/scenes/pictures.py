"""What scenes are made of: photographs and cut-outs, or procedural pictures alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from follower.training.scenes.cutout import Cutout
from follower.training.scenes.shapes import cut, random_mask
from follower.training.scenes.textures import any_texture
from follower_vision.frame import Image

_TEXTURES = 24
_TEXTURE_PX = 512
_PHOTOGRAPHS_SHARE = 0.75
_CUTOUTS_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Pictures:
    """The stock that scenes draw from.

    Attributes:
        photographs: (H, W, 3) uint8 each, no side shorter than 128 pixels.
        textures: procedural ones, likewise.
        cutouts: objects with masks.
    """

    photographs: tuple[Image, ...]
    textures: tuple[Image, ...]
    cutouts: tuple[Cutout, ...]

    def joined(self, other: Pictures) -> Pictures:
        """Return this stock and another one together."""
        return Pictures(
            self.photographs + other.photographs,
            self.textures + other.textures,
            self.cutouts + other.cutouts,
        )

    def any_ground(self, rng: np.random.Generator) -> Image:
        """Return a photograph, or sometimes a procedural texture."""
        stock = self.textures
        if self.photographs and rng.uniform() < _PHOTOGRAPHS_SHARE:
            stock = self.photographs
        return stock[int(rng.integers(len(stock)))]

    def any_object(self, rng: np.random.Generator) -> Cutout:
        """Return a ready cut-out, or a piece of a photograph in a random shape."""
        if self.cutouts and rng.uniform() < _CUTOUTS_SHARE:
            return self.cutouts[int(rng.integers(len(self.cutouts)))]
        return _piece(rng, self.any_ground(rng))


def procedural(rng: np.random.Generator, count: int = _TEXTURES) -> Pictures:
    """Return a stock that needs no file."""
    return Pictures((), tuple(any_texture(rng, _TEXTURE_PX) for _ in range(count)), ())


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
