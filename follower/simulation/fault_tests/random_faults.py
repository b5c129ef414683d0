"""Random faults, on and off, one draw after the other."""

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from follower.flight.log import TrackRecord
from follower.simulation.fault_tests.simple_vehicle import SimpleVehicle
from follower.simulation.faults.fault import FaultAction, FaultKind
from follower_vision.geometry.box import Box
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.trackers.track import Track, TrackState

TABLE = {
    FaultKind.LINK_DOWN: (0.02, 0.05, 6.0, (0.0, 0.0)),
    FaultKind.PACKETS_LOST: (0.03, 0.5, 10.0, (0.02, 0.6)),
    FaultKind.PACKETS_DOUBLED: (0.02, 0.5, 10.0, (0.1, 1.0)),
    FaultKind.PACKETS_REORDERED: (0.02, 0.5, 10.0, (0.05, 0.5)),
    FaultKind.TELEMETRY_LATE: (0.02, 0.5, 6.0, (0.02, 1.5)),
    FaultKind.GARBAGE: (0.02, 0.5, 6.0, (0.0, 0.0)),
    FaultKind.STRANGERS: (0.02, 0.5, 6.0, (0.0, 0.0)),
    FaultKind.FUZZED: (0.02, 0.5, 6.0, (0.0, 0.0)),
    FaultKind.ATTITUDE_FROZEN: (0.02, 0.1, 5.0, (0.0, 0.0)),
    FaultKind.POSITION_FROZEN: (0.02, 0.1, 5.0, (0.0, 0.0)),
    FaultKind.TELEMETRY_STOPPED: (0.02, 0.1, 5.0, (0.0, 0.0)),
    FaultKind.ATTITUDE_NAN: (0.02, 0.05, 4.0, (0.0, 0.0)),
    FaultKind.POSITION_NAN: (0.02, 0.05, 4.0, (0.0, 0.0)),
    FaultKind.POSITION_JUMPS: (0.02, 0.05, 4.0, (-500.0, 500.0)),
    FaultKind.YAW_JUMPS: (0.02, 0.05, 4.0, (-3.0, 3.0)),
    FaultKind.CLOCK_JUMPS: (0.02, 0.5, 8.0, (-30.0, 30.0)),
    FaultKind.VISION_HANGS: (0.03, 0.1, 5.0, (0.0, 0.0)),
    FaultKind.VISION_SLOW: (0.02, 1.0, 8.0, (0.1, 0.8)),
    FaultKind.FRAMES_SILENT: (0.03, 0.1, 4.0, (0.0, 0.0)),
    FaultKind.FRAMES_LATE: (0.02, 0.5, 5.0, (0.05, 1.5)),
    FaultKind.FRAMES_REORDERED: (0.02, 0.5, 5.0, (0.0, 0.0)),
    FaultKind.FRAMES_BLACK: (0.05, 0.1, 6.0, (0.0, 0.0)),
    FaultKind.FRAMES_FROZEN: (0.02, 0.1, 5.0, (0.0, 0.0)),
    FaultKind.CONTROL_STARVED: (0.02, 0.5, 4.0, (0.02, 0.6)),
    FaultKind.CONTROL_STALLS: (0.01, 0.1, 3.0, (0.0, 0.0)),
}
"""By kind: how often it begins, 1/s; shortest and longest in seconds; range of the amount."""


class RandomFaultSchedule:
    """What is on at present; asked like a `FaultSchedule`.

    Args:
        rng: draws.
        calm_s: nothing before this time.
        intensity: multiplies how often things begin.
    """

    def __init__(self, rng: np.random.Generator, calm_s: float, intensity: float) -> None:
        self._rng = rng
        self._kinds = tuple(TABLE)
        rates = np.array([TABLE[kind][0] for kind in self._kinds])
        self._shares = rates / rates.sum()
        self._mean_s = 1.0 / (intensity * float(rates.sum()))
        self._next_s = calm_s + float(rng.exponential(self._mean_s))
        self._on: dict[FaultKind, FaultAction] = {}
        self._until_s: dict[FaultKind, float] = {}
        self.counts: dict[str, int] = {}

    def step(self, now_s: float) -> None:
        """Begin and end what is due at `now_s`, seconds on the flight's clock."""
        for kind in [kind for kind, until_s in self._until_s.items() if until_s <= now_s]:
            del self._on[kind], self._until_s[kind]
        while self._next_s <= now_s:
            self._begin(self._kinds[int(self._rng.choice(len(self._kinds), p=self._shares))], now_s)
            self._next_s += float(self._rng.exponential(self._mean_s))

    def active(self, kind: FaultKind, now_s: float) -> FaultAction | None:  # noqa: ARG002
        """Return the action of this kind that is on, None if none is."""
        return self._on.get(kind)

    def end_of(self, kind: FaultKind, now_s: float) -> float:
        """Return when, in seconds, the action of this kind that is on ends; now, if none is."""
        return self._until_s.get(kind, now_s)

    def _begin(self, kind: FaultKind, now_s: float) -> None:
        _, shortest, longest, (low, high) = TABLE[kind]
        if kind not in self._on:
            for_s = math.exp(self._rng.uniform(math.log(shortest), math.log(longest)))
            amount = float(self._rng.uniform(low, high))
            self._on[kind], self._until_s[kind] = FaultAction(kind, amount), now_s + for_s
            self.counts[kind.value] = self.counts.get(kind.value, 0) + 1


class Distortion:
    """Falsifies telemetry by the schedule; see `SimpleVehicle.distort`."""

    def __init__(self, schedule: RandomFaultSchedule) -> None:
        self._schedule = schedule
        self._frozen: dict[str, Any] = {}
        self._changes: dict[str, Callable[[Any], Any]] = {
            "ATTITUDE": self._attitude,
            "LOCAL_POSITION_NED": self._position,
        }

    def __call__(self, message: Any) -> Any:
        """Return what is sent in the message's place, None for nothing."""
        change = self._changes.get(message.get_type())
        if change is None:
            return message
        if self._schedule.active(FaultKind.TELEMETRY_STOPPED, 0.0) is not None:
            return None
        jump = self._schedule.active(FaultKind.CLOCK_JUMPS, 0.0)
        if jump is not None:
            ahead_ms = int(1000.0 * jump.amount)
            message.time_boot_ms = max(0, message.time_boot_ms + ahead_ms)
        return change(message)

    def _attitude(self, m: Any) -> Any:
        jump = self._schedule.active(FaultKind.YAW_JUMPS, 0.0)
        if jump is not None:
            m.yaw = math.remainder(m.yaw + jump.amount, math.tau)
        names = ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed")
        return self._stuck(m, names, FaultKind.ATTITUDE_FROZEN, FaultKind.ATTITUDE_NAN)

    def _position(self, m: Any) -> Any:
        jump = self._schedule.active(FaultKind.POSITION_JUMPS, 0.0)
        if jump is not None:
            m.x += jump.amount
        names = ("x", "y", "z", "vx", "vy", "vz")
        return self._stuck(m, names, FaultKind.POSITION_FROZEN, FaultKind.POSITION_NAN)

    def _stuck(self, m: Any, names: tuple[str, ...], frozen: FaultKind, nan: FaultKind) -> Any:
        kind = m.get_type()
        if self._schedule.active(frozen, 0.0) is not None and kind in self._frozen:
            for name, value in self._frozen[kind].items():
                setattr(m, name, value)
        else:
            self._frozen[kind] = {name: getattr(m, name) for name in names}
        if self._schedule.active(nan, 0.0) is not None:
            for name in names:
                setattr(m, name, math.nan)
        return m


_PERIOD_S, _LATENCY_S = 1.0 / 30.0, 0.04
_SIZE_M = 2.0
_PIXELS_OF_NOISE = 1.5
_WRONG_SHARE = 0.01


class RandomTracks:
    """Tracks that are right most of the time, and late, missing or wrong by the schedule.

    Args:
        camera: its lens; pixels.
        pitch_rad: of its mount, radians, negative below the nose.
        schedule: says what is on.
        rng: draws.
        target_m: where the target is at first, metres (north, east).
    """

    def __init__(
        self,
        camera: CameraModel,
        pitch_rad: float,
        schedule: RandomFaultSchedule,
        rng: np.random.Generator,
        target_m: tuple[float, float],
    ) -> None:
        self._camera = camera
        self._pitch = math.sin(pitch_rad), math.cos(pitch_rad)
        self._schedule = schedule
        self._rng = rng
        self._target = list(target_m)
        self._target_velocity = [0.0, 0.0]
        self._due_s = 0.0
        self._sequence = 0
        self._last: Track | None = None
        self._coming: deque[tuple[float, TrackRecord]] = deque()
        self.newest: TrackRecord | None = None
        self.shows_s = -math.inf
        """Capture time of the newest frame that was handed on and shows the target."""

    def step(self, now_s: float, interval_s: float, vehicle: SimpleVehicle) -> None:
        """Move the target for `interval_s` seconds, observe it, and hand on what is ready."""
        self._move_target(interval_s)
        if now_s >= self._due_s:
            self._due_s = max(self._due_s + _PERIOD_S, now_s)
            self._observe(now_s, vehicle)
        while self._coming and self._coming[0][0] <= now_s:
            self._hand_on(self._coming.popleft()[1])

    def _move_target(self, interval_s: float) -> None:
        pull = math.sqrt(interval_s)
        for axis in range(2):
            self._target_velocity[axis] += pull * float(self._rng.normal(0.0, 1.5))
            self._target_velocity[axis] *= 1.0 - 0.2 * interval_s
            self._target[axis] += interval_s * self._target_velocity[axis]

    def _observe(self, now_s: float, vehicle: SimpleVehicle) -> None:
        off = (FaultKind.FRAMES_SILENT, FaultKind.VISION_HANGS)
        if any(self._schedule.active(kind, now_s) is not None for kind in off):
            return
        captured_s = now_s - float(self._rng.uniform(0.0, 0.01))
        if (
            self._schedule.active(FaultKind.FRAMES_REORDERED, now_s) is not None
            and self._sequence % 2
        ):
            captured_s -= 1.5 * _PERIOD_S
        self._sequence += 1
        track = self._track(now_s, captured_s, vehicle)
        late_s = sum(
            action.amount
            for kind in (FaultKind.FRAMES_LATE, FaultKind.VISION_SLOW)
            if (action := self._schedule.active(kind, now_s)) is not None
        )
        ready_s = now_s + _LATENCY_S + late_s
        slow = self._schedule.active(FaultKind.VISION_SLOW, now_s)
        self._due_s = self._due_s if slow is None else now_s + slow.amount
        record = TrackRecord(track, self._sequence, captured_s, now_s, ready_s, 0.004)
        self._coming.append((ready_s, record))

    def _hand_on(self, record: TrackRecord) -> None:
        self.newest = record
        if record.track is not None and record.track.state is TrackState.TRACKING:
            self.shows_s = max(self.shows_s, record.captured_s)

    def _track(self, now_s: float, captured_s: float, vehicle: SimpleVehicle) -> Track | None:
        box = self._seen(vehicle)
        blind = self._schedule.active(FaultKind.FRAMES_BLACK, now_s) is not None
        frozen = self._schedule.active(FaultKind.FRAMES_FROZEN, now_s) is not None
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

    def _seen(self, vehicle: SimpleVehicle) -> Box | None:
        """Return the box of the target, None if it is out of view."""
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
