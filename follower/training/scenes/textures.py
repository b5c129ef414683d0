"""Procedural pictures: no photograph is needed to make a scene."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.frame import Image

_LEAST_RADIUS_PX = 4.0


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


def any_texture(rng: np.random.Generator, side: int) -> Image:
    """Return one of the kinds, at random."""
    kinds = (noise_texture, leaves_texture, leaves_texture, stripes_texture)
    return kinds[int(rng.integers(len(kinds)))](rng, side)


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
