"""A simulated camera: frames at a rate, late, unevenly, and sometimes not at all."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Protocol

import numpy as np

from follower_sim.exposure import Exposure
from follower_sim.kinematics import BodyState
from follower_sim.render import Renderer
from follower_sim.scenario import CameraSettings
from follower_sim.sensor import Sensor
from follower_sim.world import World
from follower_vision.clock import Clock
from follower_vision.frame import Frame, Image

_SHAKEN_RAD_S = 1.6
_SHAKEN_EXPOSURE_S = 0.022


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


class Draws(Protocol):
    """Draws what a camera sees."""

    def render(self, time_s: float, body: BodyState, exposure_s: float = 0.0) -> Image:
        """Return the image, (H, W, 3) uint8 BGR, of an exposure."""
        ...


class SimCamera:
    """Takes pictures of a world from a moving vehicle.

    In lockstep, ask `next_capture_s`, call `capture` at that time and hand the frame on at the
    delivery's time. In real time, call `read` from a thread of its own.

    Args:
        world: what there is to see; its scenario has the camera's settings and faults.
        state_at: where the vehicle is at a time on the system's clock.
        start_s: the system's time at which the scenario's time is 0.
        renderer: to share a renderer between cameras; made from the world if None.
        seed: of the camera's randomness; the world's if None.
    """

    def __init__(
        self,
        world: World,
        state_at: Callable[[float], BodyState],
        start_s: float = 0.0,
        renderer: Draws | None = None,
        seed: int | None = None,
    ) -> None:
        self._settings: CameraSettings = world.scenario.camera
        self._faults = world.scenario.faults
        self._state_at = state_at
        self._start_s = start_s
        self._scene_time = world.scene_time
        self._renderer: Draws = renderer or Renderer(world)
        root = world.seed if seed is None else seed
        self._timing = np.random.default_rng([root, 11])
        self._shaking = np.random.default_rng([root, 13])
        self._sensor = Sensor(self._settings, np.random.default_rng([root, 12]))
        self._sequence = 0
        self._last: Callable[[], Image] | None = None
        self.next_capture_s = start_s
        """Middle of the next exposure, on the system's clock."""

    @property
    def rate_hz(self) -> float:
        """Frames a second, dropped ones counted."""
        return self._settings.rate_hz

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
        period = 1 / self._settings.rate_hz
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
            image = self._renderer.render(time_s, body, exposure_s)
            return self._sensor.expose(image, time_s, grain)

        self._last = draw
        return draw

    def read(self, clock: Clock) -> Frame | None:
        """Wait for the next picture and return it when it arrives; None if it was dropped.

        A computer that renders too slowly misses pictures, as it would miss those of a real
        camera; the sequence numbers show it.
        """
        while self.next_capture_s + 1 / self._settings.rate_hz < clock.now():
            self._schedule_next()
        clock.sleep_until(self.next_capture_s)
        delivery = self.capture()
        if delivery is None:
            return None
        clock.sleep_until(delivery.available_s)
        return delivery.frame


def _shaken(body: BodyState, rng: np.random.Generator) -> BodyState:
    """Return the body turning quickly about a random axis that blurs the picture."""
    angle = float(rng.uniform(0, 2 * math.pi))
    down, right = _SHAKEN_RAD_S * math.cos(angle), _SHAKEN_RAD_S * math.sin(angle)
    return replace(body, rates_rad_s=(body.rates_rad_s[0], right, down))
