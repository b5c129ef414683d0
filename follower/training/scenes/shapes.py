"""Random masks that turn a piece of a photograph into an object."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.frame import Image

Mask = npt.NDArray[np.uint8]
_FINER = 4


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
