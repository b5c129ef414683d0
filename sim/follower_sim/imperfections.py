"""What lens and sensor do to a picture: dirt, rows that are read in turn, and little light."""

from __future__ import annotations

from typing import TypeAlias

import cv2
import numpy as np

from follower_sim.kinematics import Triple
from follower_sim.scenario.weather import LowLightSettings
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.geometry.line_of_sight import CameraMount
from follower_vision.images.frame import Image

Noise: TypeAlias = tuple[Image, Image]
"""The positive and the negative part of a field of noise."""

_MUD, _DUST = (38, 46, 58), (206, 210, 214)
_MUD_SHARE, _MUD_OPACITY, _DUST_OPACITY = 0.6, 0.95, 0.6
_SMALLEST, _LARGEST, _SOFT = 0.012, 0.05, 0.009

_GAMMA = 2.2
_SIGMA_UNIT, _NOISE_UNIT = 4, 32


class LensDirt:
    """Spots on the lens: mud that hides and dust that shines, out of focus, fixed in the image.

    Args:
        share: of the image that is covered, 0 to 1.
        size: width and height of the image.
        rng: draws where the spots are.
    """

    def __init__(self, share: float, size: tuple[int, int], rng: np.random.Generator) -> None:
        width, height = size
        mud, dust = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
        while np.mean((mud > 0) | (dust > 0)) < share:
            place = rng.uniform(0, 1, 2) * (width, height)
            radii = rng.uniform(_SMALLEST, _LARGEST) * width * rng.uniform(0.6, 1.0, 2)
            is_mud = rng.uniform() < _MUD_SHARE
            box = (place.tolist(), (2 * radii).tolist(), float(rng.uniform(0, 180)))
            cv2.ellipse(
                mud if is_mud else dust, box, _MUD_OPACITY if is_mud else _DUST_OPACITY, cv2.FILLED
            )
        hidden = cv2.GaussianBlur(mud, (0, 0), _SOFT * width)
        shining = cv2.GaussianBlur(dust, (0, 0), _SOFT * width) * (1 - hidden)
        self._cover = np.asarray(hidden + shining, np.float32)
        self._clear = 1 - self._cover
        light = hidden[..., None] * np.array(_MUD) + shining[..., None] * np.array(_DUST)
        self._dirt = (light / np.maximum(self._cover, 1e-6)[..., None]).astype(np.uint8)

    def over(self, image: Image) -> Image:
        """Return the image, (H, W, 3) uint8, behind the dirt."""
        return np.asarray(cv2.blendLinear(image, self._dirt, self._clear, self._cover), np.uint8)


class RollingShutter:
    """Lets each row see as the camera is turned at its own time; the frame's is the middle one's.

    Only the turning counts: what the camera and the targets move meanwhile is left out. At the
    edges pixels repeat that were not in the picture.

    Args:
        row_time_s: from one row to the next.
        camera: intrinsics and distortion.
        mount: how the camera is turned against the body.
    """

    def __init__(self, row_time_s: float, camera: CameraModel, mount: CameraMount) -> None:
        self._camera_to_body = mount.camera_to_body
        shape = camera.height, camera.width
        columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
        pixels = np.column_stack([columns.ravel(), rows.ravel()])
        rays = camera.rays(pixels)
        late_s = (pixels[:, 1] - camera.height / 2) * row_time_s
        self._at = [(pixels[:, i] - 0.5).astype(np.float32).reshape(shape) for i in (0, 1)]
        small = 1e-4
        self._flows = []
        for axis in np.eye(3):
            turned = camera.pixels(rays + small * np.cross(axis, rays))
            flow = (turned - pixels) / small * late_s[:, None]
            self._flows.append([flow[:, i].astype(np.float32).reshape(shape) for i in (0, 1)])

    def read(self, image: Image, rates_rad_s: Triple) -> Image:
        """Return the image, (H, W, 3), as its rows see it while the body turns at rates, rad/s."""
        rates = (self._camera_to_body.T @ np.array(rates_rad_s)).tolist()
        x, y = (plane.copy() for plane in self._at)
        for rate, (across, down) in zip(rates, self._flows, strict=True):
            cv2.scaleAdd(across, rate, x, x)
            cv2.scaleAdd(down, rate, y, y)
        seen = cv2.remap(image, x, y, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
        return np.asarray(seen, np.uint8)


class LowLight:
    """Shot and read noise of few photons, behind a gain and the usual gamma of 2.2.

    The noise of a pixel is Gaussian with the variance of the photons (Poisson) and the reading.

    Args:
        settings: how dark it is, and the sensor.
        shape: of the fields of noise, (H, W, 3).
        rng: source of randomness.
    """

    def __init__(
        self, settings: LowLightSettings, shape: tuple[int, int, int], rng: np.random.Generator
    ) -> None:
        gain = 2.0 ** min(settings.stops, settings.gain_stops)
        level = (np.arange(256) / 255) ** _GAMMA
        electrons = level * settings.full_well_e / 2**settings.stops
        spread = gain / settings.full_well_e * np.sqrt(electrons + settings.read_noise_e**2)
        light = level * gain / 2**settings.stops
        grey, above, below = (
            255 * np.clip(value, 0, 1) ** (1 / _GAMMA)
            for value in (light, light + spread, light - spread)
        )
        self._grey = grey.round().astype(np.uint8)
        self._sigma = (_SIGMA_UNIT * (above - below) / 2).round().clip(0, 255).astype(np.uint8)
        self._noise = noise(_NOISE_UNIT, shape, rng)

    def expose(self, image: Image, part: tuple[slice, slice]) -> Image:
        """Return the image, (H, W, 3) uint8, with the noise of a part of the field."""
        sigma, scale = cv2.LUT(image, self._sigma), 1 / (_SIGMA_UNIT * _NOISE_UNIT)
        brighter, darker = (cv2.multiply(sigma, one[part], scale=scale) for one in self._noise)
        dark = cv2.LUT(image, self._grey)
        return np.asarray(cv2.subtract(cv2.add(dark, brighter), darker), np.uint8)


def noise(sigma: float, shape: tuple[int, int, int], rng: np.random.Generator) -> Noise:
    """Return a Gaussian field of a standard deviation in grey levels."""
    field = np.round(rng.standard_normal(shape, np.float32) * sigma)
    return np.clip(field, 0, 255).astype(np.uint8), np.clip(-field, 0, 255).astype(np.uint8)
