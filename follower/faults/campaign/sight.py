"""Tracks of a target that wanders about, without any pixels."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from follower.faults.campaign.vehicle import CheapVehicle
from follower.faults.campaign.weather import Weather
from follower.faults.fault import Kind
from follower.flightlog import TrackRecord
from follower_vision.box import Box
from follower_vision.camera import CameraModel
from follower_vision.track import Track, TrackState

_PERIOD_S, _LATENCY_S = 1.0 / 30.0, 0.04
_SIZE_M = 2.0
_PIXELS_OF_NOISE = 1.5
_WRONG_SHARE = 0.01


class RandomSight:
    """A vision that is right most of the time, and late, blind or wrong as the weather says.

    Args:
        camera: its lens.
        pitch_rad: of its mount.
        weather: says what is on.
        rng: draws.
        target_m: where the target is at first (north, east).
    """

    def __init__(
        self,
        camera: CameraModel,
        pitch_rad: float,
        weather: Weather,
        rng: np.random.Generator,
        target_m: tuple[float, float],
    ) -> None:
        self._camera = camera
        self._pitch = math.sin(pitch_rad), math.cos(pitch_rad)
        self._weather = weather
        self._rng = rng
        self._target = list(target_m)
        self._pace = [0.0, 0.0]
        self._due_s = 0.0
        self._sequence = 0
        self._last: Track | None = None
        self._coming: deque[tuple[float, TrackRecord]] = deque()
        self.newest: TrackRecord | None = None
        self.shows_s = -math.inf
        """Capture time of the newest frame that was handed on and shows the target."""

    def step(self, now_s: float, interval_s: float, vehicle: CheapVehicle) -> None:
        """Move the target, look, and hand on what is ready."""
        self._wander(interval_s)
        if now_s >= self._due_s:
            self._due_s = max(self._due_s + _PERIOD_S, now_s)
            self._look(now_s, vehicle)
        while self._coming and self._coming[0][0] <= now_s:
            self._hand_on(self._coming.popleft()[1])

    def _wander(self, interval_s: float) -> None:
        pull = math.sqrt(interval_s)
        for axis in range(2):
            self._pace[axis] += pull * float(self._rng.normal(0.0, 1.5))
            self._pace[axis] *= 1.0 - 0.2 * interval_s
            self._target[axis] += interval_s * self._pace[axis]

    def _look(self, now_s: float, vehicle: CheapVehicle) -> None:
        off = (Kind.FRAMES_SILENT, Kind.VISION_HANGS)
        if any(self._weather.active(kind, now_s) is not None for kind in off):
            return
        captured_s = now_s - float(self._rng.uniform(0.0, 0.01))
        if self._weather.active(Kind.FRAMES_REORDERED, now_s) is not None and self._sequence % 2:
            captured_s -= 1.5 * _PERIOD_S
        self._sequence += 1
        track = self._track(now_s, captured_s, vehicle)
        late_s = sum(
            action.amount
            for kind in (Kind.FRAMES_LATE, Kind.VISION_SLOW)
            if (action := self._weather.active(kind, now_s)) is not None
        )
        ready_s = now_s + _LATENCY_S + late_s
        slow = self._weather.active(Kind.VISION_SLOW, now_s)
        self._due_s = self._due_s if slow is None else now_s + slow.amount
        record = TrackRecord(track, self._sequence, captured_s, now_s, ready_s, 0.004)
        self._coming.append((ready_s, record))

    def _hand_on(self, record: TrackRecord) -> None:
        self.newest = record
        if record.track is not None and record.track.state is TrackState.TRACKING:
            self.shows_s = max(self.shows_s, record.captured_s)

    def _track(self, now_s: float, captured_s: float, vehicle: CheapVehicle) -> Track | None:
        box = self._seen(vehicle)
        blind = self._weather.active(Kind.FRAMES_BLACK, now_s) is not None
        frozen = self._weather.active(Kind.FRAMES_FROZEN, now_s) is not None
        if frozen and self._last is not None:
            return Track(
                self._last.box, self._last.state, 0.9, "random", captured_s, self._sequence
            )
        if self._rng.random() < _WRONG_SHARE:
            box = self._anything()
        if box is not None and not blind:
            self._last = Track(box, TrackState.TRACKING, 0.9, "random", captured_s, self._sequence)
        elif self._last is not None:
            state = TrackState.COASTING if self._rng.random() < 0.5 else TrackState.LOST
            self._last = Track(self._last.box, state, 0.1, "random", captured_s, self._sequence)
        return self._last

    def _seen(self, vehicle: CheapVehicle) -> Box | None:
        """Return the box of the target, None if it is out of sight."""
        north, east, down = vehicle.position_m
        away_n, away_e, away_d = self._target[0] - north, self._target[1] - east, -1.0 - down
        c, s = math.cos(vehicle.yaw_rad), math.sin(vehicle.yaw_rad)
        forward, right = c * away_n + s * away_e, c * away_e - s * away_n
        sine, cosine = self._pitch
        ahead, below = cosine * forward - sine * away_d, sine * forward + cosine * away_d
        camera = self._camera
        if ahead < 0.5:
            return None
        side = camera.fx * _SIZE_M / ahead
        shaken = self._rng.normal(0.0, _PIXELS_OF_NOISE, 3).tolist()
        cx = camera.cx + camera.fx * right / ahead + shaken[0]
        cy = camera.cy + camera.fy * below / ahead + shaken[1]
        if not (0 < cx < camera.width and 0 < cy < camera.height):
            return None
        side = max(2.0, side + shaken[2])
        return Box(cx, cy, side, side)

    def _anything(self) -> Box:
        width, height = self._camera.width, self._camera.height
        cx, cy = self._rng.uniform(-width, 2 * width), self._rng.uniform(-height, 2 * height)
        sides = np.exp(self._rng.uniform(-3.0, 9.0, 2))
        return Box(float(cx), float(cy), float(sides[0]), float(sides[1]))
