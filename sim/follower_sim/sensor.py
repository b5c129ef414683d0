"""What an image sensor does to a picture: brightness, vignetting, noise."""

from __future__ import annotations

import math
from typing import TypeAlias

import cv2
import numpy as np

from follower_sim.scenario import CameraSettings
from follower_vision.frame import Image

Grain: TypeAlias = tuple[int, int]
"""Row and column of a field of noise."""

_ROOM_PX = 64
_PERIODS_S = (17.0, 6.3, 2.9)


class Sensor:
    """Adds a camera's imperfections to rendered images.

    Noise is Gaussian and the same for all brightnesses; it is cut at a random place out of one
    field made beforehand, which is what makes it fast enough.

    Args:
        settings: noise, vignetting and drift of the exposure.
        rng: source of randomness.
    """

    def __init__(self, settings: CameraSettings, rng: np.random.Generator) -> None:
        self._rng = rng
        self._drift = settings.exposure_drift
        self._phases = rng.uniform(0, 2 * math.pi, len(_PERIODS_S))
        self._vignette = _vignette(settings) if settings.vignetting > 0 else None
        self._noise = _noise(settings, rng) if settings.noise > 0 else None

    def grain(self) -> Grain:
        """Draw where the next picture's noise is cut out of the field."""
        row, column = self._rng.integers(_ROOM_PX, size=2)
        return int(row), int(column)

    def expose(self, image: Image, time_s: float, grain: Grain) -> Image:
        """Return the image, (H, W, 3) uint8 BGR, as the sensor gives it at a time."""
        gain = self.gain(time_s)
        if self._vignette is None:
            gained = cv2.convertScaleAbs(image, alpha=gain)
        else:
            gained = cv2.multiply(image, self._vignette, scale=gain / 255)
        if self._noise is not None:
            (row, column), (height, width) = grain, image.shape[:2]
            part = slice(row, row + height), slice(column, column + width)
            brighter, darker = self._noise
            cv2.subtract(cv2.add(gained, brighter[part]), darker[part], dst=gained)
        return np.asarray(gained, np.uint8)

    def gain(self, time_s: float) -> float:
        """Return the brightness as the slowly hunting automatic exposure sets it."""
        waves = [
            math.sin(2 * math.pi * time_s / period + phase)
            for period, phase in zip(_PERIODS_S, self._phases, strict=True)
        ]
        return 1 + self._drift * sum(waves) / len(waves)


def _vignette(settings: CameraSettings) -> Image:
    """Return a factor of 0 to 255 for each pixel and channel."""
    x = np.linspace(-1, 1, settings.width)[None, :]
    y = np.linspace(-1, 1, settings.height)[:, None]
    light = 255 * (1 - settings.vignetting * (x * x + y * y) / 2)
    return np.repeat(light.round().astype(np.uint8)[..., None], 3, axis=2)


def _noise(settings: CameraSettings, rng: np.random.Generator) -> tuple[Image, Image]:
    """Return the positive and the negative part of a field larger than the image."""
    shape = settings.height + _ROOM_PX, settings.width + _ROOM_PX, 3
    field = np.round(rng.standard_normal(shape, np.float32) * settings.noise)
    return np.clip(field, 0, 255).astype(np.uint8), np.clip(-field, 0, 255).astype(np.uint8)
