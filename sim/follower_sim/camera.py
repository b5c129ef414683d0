"""A simulated camera: frames at a rate, late, unevenly, and sometimes not at all."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import TypeAlias

import cv2
import numpy as np

from follower_sim.imperfections import LensDirt, LowLight, RollingShutter, noise
from follower_sim.kinematics import BodyState
from follower_sim.scenario.scenario import SimCameraSettings
from follower_sim.world.render import Renderer
from follower_sim.world.world import World
from follower_vision.clock import Clock
from follower_vision.images.frame import Frame, Image

Grain: TypeAlias = tuple[int, int]
"""Row and column of a field of noise."""

Render: TypeAlias = Callable[[float, BodyState, float], Image]
"""Draws an exposure: its middle in the scenario's time, the vehicle then, its length in seconds."""

_ROOM_PX = 64
_PERIODS_S = (17.0, 6.3, 2.9)

_SHAKEN_RAD_S = 1.6
_SHAKEN_EXPOSURE_S = 0.022


class Sensor:
    """Adds a camera's imperfections to rendered images.

    Noise is Gaussian and the same for all brightnesses; it is cut at a random place out of one
    field made beforehand, which is what makes it fast enough.

    Args:
        settings: noise, light, vignetting and drift of the exposure.
        rng: source of randomness.
    """

    def __init__(self, settings: SimCameraSettings, rng: np.random.Generator) -> None:
        self._rng = rng
        self._drift = settings.exposure_drift
        self._phases = rng.uniform(0, 2 * math.pi, len(_PERIODS_S))
        self._vignette = _vignette(settings) if settings.vignetting > 0 else None
        shape = settings.height + _ROOM_PX, settings.width + _ROOM_PX, 3
        self._noise = noise(settings.noise, shape, rng) if settings.noise > 0 else None
        dark = settings.low_light
        self._low_light = LowLight(dark, shape, rng.spawn(1)[0]) if dark.stops > 0 else None

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
        (row, column), (height, width) = grain, image.shape[:2]
        part = slice(row, row + height), slice(column, column + width)
        if self._low_light is not None:
            gained = self._low_light.expose(np.asarray(gained, np.uint8), part)
        if self._noise is not None:
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


def _vignette(settings: SimCameraSettings) -> Image:
    """Return a factor of 0 to 255 for each pixel and channel."""
    x = np.linspace(-1, 1, settings.width)[None, :]
    y = np.linspace(-1, 1, settings.height)[:, None]
    light = 255 * (1 - settings.vignetting * (x * x + y * y) / 2)
    return np.repeat(light.round().astype(np.uint8)[..., None], 3, axis=2)


class Exposure:
    """What a camera took at one time; drawing it costs time, so that what nobody looks at is not.

    When it is drawn makes no difference to the picture.

    Args:
        draw: returns the picture, the same whenever it is called.
        captured_s: middle of the exposure, on the system's clock.
        sequence: number of the frame.
        size: width and height of the picture.
    """

    def __init__(
        self, draw: Callable[[], Image], captured_s: float, sequence: int, size: tuple[int, int]
    ) -> None:
        self._draw = draw
        self.captured_s = captured_s
        self.sequence = sequence
        self._size = size

    @cached_property
    def frame(self) -> Frame:
        """The picture, drawn now if it was not before."""
        return Frame(self._draw(), self.captured_s, self.sequence)

    @property
    def unseen(self) -> Frame:
        """A black frame with its times and size, for those who do not look at pictures."""
        return Frame(_black(*self._size), self.captured_s, self.sequence)

    def replaced(self, draw: Callable[[], Image]) -> Exposure:
        """Return one of the same time that shows something else."""
        return Exposure(draw, self.captured_s, self.sequence, self._size)


@dataclass(frozen=True, slots=True)
class Delivery:
    """A picture and when the computer gets it.

    Attributes:
        exposure: stamped with the middle of its time (plus the camera's stamp offset).
        available_s: when it arrives, on the system's clock.
    """

    exposure: Exposure
    available_s: float

    @property
    def frame(self) -> Frame:
        """The picture, drawn now at the latest."""
        return self.exposure.frame


class SimCamera:
    """Takes pictures of a world from a moving vehicle.

    In lockstep, ask `next_capture_s`, call `capture` at that time and hand the frame on at the
    delivery's time. In real time, call `read` from a thread of its own.

    Args:
        world: what there is to see; its scenario has the camera's settings and faults.
        state_at: where the vehicle is at a time on the system's clock.
        start_s: the system's time at which the scenario's time is 0.
        render: draws the image, (H, W, 3) uint8 BGR, of an exposure at a time with the vehicle at
            a pose; None draws the world.
        seed: of the camera's randomness; the world's if None.

    Attributes:
        rate_hz: frames a second.
    """

    def __init__(
        self,
        world: World,
        state_at: Callable[[float], BodyState],
        start_s: float = 0.0,
        render: Render | None = None,
        seed: int | None = None,
    ) -> None:
        self._settings: SimCameraSettings = world.scenario.camera
        self.rate_hz = self._settings.rate_hz
        self._faults = world.scenario.faults
        self._state_at = state_at
        self._start_s = start_s
        self._scene_time = world.scene_time
        self._render = render or Renderer(world).render
        root = world.seed if seed is None else seed
        self._timing = np.random.default_rng([root, 11])
        self._shaking = np.random.default_rng([root, 13])
        self._sensor = Sensor(self._settings, np.random.default_rng([root, 12]))
        self._optics = _optics(self._settings, np.random.default_rng([root, 14]))
        self._sequence = 0
        self._last: Callable[[], Image] | None = None
        self._under_way = deque[Delivery]()
        self.next_capture_s = start_s
        """Middle of the next exposure, on the system's clock."""

    def capture(self) -> Delivery | None:
        """Take the picture due at `next_capture_s` and go on to the next one.

        Returns:
            The frame and its time of arrival, or None if the camera dropped it.
        """
        captured_s, sequence = self.next_capture_s, self._sequence
        dropped = self._timing.uniform() < self._settings.drop_probability
        late_s = self._settings.latency_s
        late_s += abs(self._timing.normal(0, self._settings.latency_jitter_s or 0))
        self._schedule_next()
        fault = self._fault(self._scene_time(captured_s - self._start_s))
        if dropped or fault == "silent":
            return None
        stamp_s = captured_s + self._settings.stamp_offset_s
        size = self._settings.width, self._settings.height
        exposure = Exposure(self._picture(captured_s, fault), stamp_s, sequence, size)
        return Delivery(exposure, captured_s + late_s)

    def _schedule_next(self) -> None:
        """Jitter moves single pictures about an even schedule, never one past the next."""
        self._sequence += 1
        period = 1 / self.rate_hz
        jitter = float(self._timing.normal(0, self._settings.jitter_s))
        jitter = min(max(jitter, -0.4 * period), 0.4 * period)
        self.next_capture_s = self._start_s + self._sequence * period + jitter

    def _fault(self, time_s: float) -> str | None:
        """Return the camera's fault at a time of the scenario."""
        active = [f.kind for f in self._faults if f.from_s <= time_s < f.until_s]
        return next((kind for kind in active if kind != "target_removed"), None)

    def _picture(self, captured_s: float, fault: str | None) -> Callable[[], Image]:
        """Return what draws the picture; all that changes with time or chance is taken now."""
        if fault == "frozen" and self._last is not None:
            return self._last
        time_s, grain = captured_s - self._start_s, self._sensor.grain()
        if fault == "black":
            shape = self._settings.height, self._settings.width, 3
            return lambda: self._sensor.expose(np.zeros(shape, np.uint8), time_s, grain)
        body, exposure_s = self._state_at(captured_s), self._settings.exposure_s
        if fault == "shaken":
            body, exposure_s = _shaken(body, self._shaking), _SHAKEN_EXPOSURE_S

        @cache
        def draw() -> Image:
            image = self._optics(self._render(time_s, body, exposure_s), body)
            return self._sensor.expose(image, time_s, grain)

        self._last = draw
        return draw

    def read(self, clock: Clock) -> Frame | None:
        """Wait for the next picture and return it when it arrives; None if one was dropped.

        Pictures are taken at their rate, however long they are under way. A computer that renders
        too slowly misses some, as it would miss those of a real camera; the sequence numbers show
        it.
        """
        while not self._under_way or self.next_capture_s < self._under_way[0].available_s:
            while self.next_capture_s + 1 / self.rate_hz < clock.now():
                self._schedule_next()
            clock.sleep_until(self.next_capture_s)
            delivery = self.capture()
            if delivery is None:
                return None
            self._under_way.append(delivery)
        delivery = self._under_way.popleft()
        frame = delivery.frame
        clock.sleep_until(delivery.available_s)
        return frame


def _optics(
    settings: SimCameraSettings, rng: np.random.Generator
) -> Callable[[Image, BodyState], Image]:
    """Return what shutter and lens make of a rendered image, seen from a body."""
    shutter, dirt = None, None
    if settings.row_time_s > 0:
        shutter = RollingShutter(settings.row_time_s, settings.model, settings.mount)
    if settings.lens_dirt > 0:
        dirt = LensDirt(settings.lens_dirt, (settings.width, settings.height), rng)

    def through(image: Image, body: BodyState) -> Image:
        image = image if shutter is None else shutter.read(image, body.rates_rad_s)
        return image if dirt is None else dirt.over(image)

    return through


def _shaken(body: BodyState, rng: np.random.Generator) -> BodyState:
    """Return the body turning quickly about a random axis that blurs the picture."""
    angle = float(rng.uniform(0, 2 * math.pi))
    down, right = _SHAKEN_RAD_S * math.cos(angle), _SHAKEN_RAD_S * math.sin(angle)
    return replace(body, rates_rad_s=(body.rates_rad_s[0], right, down))


class BlindCamera(SimCamera):
    """The simulated camera with its rate, latency, jitter and drops, and black pictures."""

    def __init__(self, world: World, state_at: Callable[[float], BodyState]) -> None:
        black = _black(world.scenario.camera.width, world.scenario.camera.height)
        super().__init__(world, state_at, render=lambda *_: black)
        self._black = black

    def _picture(self, *_: object) -> Callable[[], Image]:
        return lambda: self._black


def _black(width: int, height: int) -> Image:
    return np.broadcast_to(np.zeros((1, 1, 3), np.uint8), (height, width, 3))
