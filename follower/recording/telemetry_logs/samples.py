"""What all kinds of telemetry logs come down to."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self, TypeVar

import numpy as np

from follower_control.common.clock_offset import AngularRates
from follower_control.vehicle.gimbal import camera_to_world
from follower_control.vehicle.state import (
    Attitude,
    GimbalState,
    LocalPosition,
    Origin,
    VehicleState,
)
from follower_vision.geometry.camera_model import Vector
from follower_vision.geometry.line_of_sight import rotation
from follower_vision.sources.frame_source import SourceError

_LEAST_SAMPLES = 2
_VELOCITY_S = 1.0
_LONGEST_S = 24 * 3600.0


class TelemetryError(SourceError):
    """A telemetry log cannot be used; the message says which, why and what would do."""


@dataclass(frozen=True, slots=True)
class ModeChange:
    """From `time_s` (seconds on the log's clock) on the vehicle is in a mode."""

    time_s: float
    mode: str
    armed: bool


@dataclass(frozen=True, slots=True, eq=False)
class TelemetryLog:
    """A vehicle's telemetry, each part in the order of time.

    Attributes:
        attitudes: at least two, or none if there are positions.
        rates: the gyro's, or those that come with the attitudes.
        positions: local positions; none if the log has none.
        modes: changes of mode; none if the log has none.
        gimbals: how the camera is held; none if it is fixed, or nobody knows.
        origin: where local positions count from, None if that is not told.
        fov_deg: the camera's horizontal field of view, None if that is not told.
        lens: what is told of a calibrated lens, as `CameraSettings` has it.
        on_video_clock: times are the video's, as the recording tells them.
        problem: what of the log could not be read, None if nothing.
    """

    attitudes: tuple[Attitude, ...]
    rates: AngularRates
    positions: tuple[LocalPosition, ...] = ()
    modes: tuple[ModeChange, ...] = ()
    gimbals: tuple[GimbalState, ...] = ()
    origin: Origin | None = None
    fov_deg: float | None = None
    lens: dict[str, Any] = field(default_factory=dict)
    on_video_clock: bool = False
    problem: str | None = None

    @property
    def start_s(self) -> float:
        """The first attitude's time; without attitudes the first position's."""
        return (self.attitudes or self.positions)[0].time_s

    @property
    def end_s(self) -> float:
        """The last one's."""
        return (self.attitudes or self.positions)[-1].time_s

    @property
    def has_motion(self) -> bool:
        """Whether it tells both how the vehicle is turned and where it is."""
        return bool(self.attitudes and self.positions)

    def of_camera(self) -> Self:
        """Return the attitudes and rates of what a gimbal holds, as if it were the vehicle."""
        if not self.gimbals or not self.attitudes:
            return self
        time = np.array([one.time_s for one in self.gimbals])
        known = np.array([(one.time_s, *one.numbers) for one in self.attitudes])
        angles = [np.interp(time, known[:, 0], np.unwrap(one)) for one in known[:, 1:4].T]
        held = [
            camera_to_world(gimbal, Attitude(roll, pitch, yaw, 0.0, 0.0, 0.0, gimbal.time_s))
            for gimbal, roll, pitch, yaw in zip(self.gimbals, *angles, strict=True)
        ]
        # From camera axes (right, down, forward) to those of a body that looks along its nose.
        turns = np.array(held)[:, :, [2, 0, 1]]
        rates = _turning(time, turns)
        parts = np.column_stack([_euler(turns), np.vstack([rates, rates[-1:]]), time])
        return replace(
            self,
            attitudes=tuple(Attitude(*row) for row in parts.tolist()),
            rates=AngularRates(time[:-1], time[1:], rates),
        )

    def moved(self, by_s: float) -> Self:
        """Return the same with `by_s` seconds added to all times."""
        rates = self.rates
        return replace(
            self,
            attitudes=tuple(replace(one, time_s=one.time_s + by_s) for one in self.attitudes),
            rates=AngularRates(rates.start_s + by_s, rates.end_s + by_s, rates.rates_rad_s),
            positions=tuple(replace(one, time_s=one.time_s + by_s) for one in self.positions),
            modes=tuple(replace(one, time_s=one.time_s + by_s) for one in self.modes),
            gimbals=tuple(
                replace(one, attitude=replace(one.attitude, time_s=one.time_s + by_s))
                for one in self.gimbals
            ),
        )


@dataclass(slots=True)
class TelemetrySamples:
    """What a reader has found so far; rows may come in any order.

    Attributes:
        attitudes: (time, roll, pitch, yaw) in seconds and radians.
        attitude_rates: body rates that came with each attitude; empty if none did.
        gyro: (time, about forward, right, down) of a faster gyro, if there is one.
        positions: (time, north, east, down, and their velocities).
        modes: changes of mode.
        places: (time, north, east, down) where nobody measures velocities.
        gimbals: (time, roll, pitch, yaw) of the camera.
        gimbal_from_north: those are against the horizon and from north; else against the body.
        origin, fov_deg, lens, on_video_clock, problem: see `TelemetryLog`.
    """

    attitudes: list[tuple[float, ...]] = field(default_factory=list)
    attitude_rates: list[tuple[float, ...]] = field(default_factory=list)
    gyro: list[tuple[float, ...]] = field(default_factory=list)
    positions: list[tuple[float, ...]] = field(default_factory=list)
    modes: list[ModeChange] = field(default_factory=list)
    places: list[tuple[float, ...]] = field(default_factory=list)
    gimbals: list[tuple[float, ...]] = field(default_factory=list)
    gimbal_from_north: bool = False
    origin: Origin | None = None
    fov_deg: float | None = None
    lens: dict[str, Any] = field(default_factory=dict)
    on_video_clock: bool = False
    problem: str | None = None

    def add_fix(
        self, time_s: float, latitude_deg: float, longitude_deg: float, height_m: float
    ) -> None:
        """Note a place on earth, its height above what heights count from; the first is 0, 0.

        What is no place on earth is passed over.
        """
        if not (abs(latitude_deg) <= 90 and abs(longitude_deg) <= 180):
            return
        self.origin = self.origin or Origin(latitude_deg, longitude_deg)
        north_m, east_m = self.origin.local(latitude_deg, longitude_deg)
        self.places.append((time_s, north_m, east_m, -height_m))

    def velocities(self) -> Vector:
        """Return the places with their velocities over a second: rows like `positions`, (N, 7)."""
        rows = _clean(_table(self.places, 4), 4)
        if len(rows) < _LEAST_SAMPLES:
            return np.hstack([rows, np.zeros((len(rows), 3))])
        time = rows[:, 0]
        half_s = max(_VELOCITY_S, float(np.median(np.diff(time)))) / 2
        before, after = np.maximum(time - half_s, time[0]), np.minimum(time + half_s, time[-1])
        moved = [
            np.interp(after, time, one) - np.interp(before, time, one) for one in rows[:, 1:].T
        ]
        return np.column_stack([rows, np.column_stack(moved) / (after - before)[:, None]])

    def add_mode(self, time_s: float, mode: str, armed: bool) -> None:
        """Note a mode at a time in seconds, if it is another one than before."""
        newest = self.modes[-1] if self.modes else None
        changes = newest is None or (newest.mode, newest.armed) != (mode, armed)
        if changes and math.isfinite(time_s):
            self.modes.append(ModeChange(time_s, mode, armed))

    def log(self, named: str) -> TelemetryLog:
        """Return the log, without rows that are not finite or not later than the one before.

        Args:
            named: the file, for messages.

        Raises:
            TelemetryError: there are fewer than two attitudes, and no places either; or times are
                no seconds.
        """
        try:
            places = _clean(_table(self.positions, 7), 7)
            if not len(places):
                places = self.velocities()
            parts, rates = self._turns(len(places) > 0)
            gimbals = self._held()
        except TelemetryError as error:
            raise TelemetryError(f"{named}: {error}") from error
        return TelemetryLog(
            tuple(Attitude(*row) for row in parts.tolist()),
            rates,
            tuple(LocalPosition(*row) for row in np.roll(places, -1, axis=1).tolist()),
            tuple(sorted(self.modes, key=lambda one: one.time_s)),
            gimbals,
            self.origin,
            self.fov_deg,
            self.lens,
            self.on_video_clock,
            self.problem,
        )

    def _held(self) -> tuple[GimbalState, ...]:
        rows = _clean(_table(self.gimbals, 4), 4)
        if len(rows) < _LEAST_SAMPLES:
            return ()
        turns = np.array([rotation(*angles) for angles in rows[:, 1:].tolist()])
        rates = _turning(rows[:, 0], turns)
        parts = np.column_stack([rows[:, 1:], np.vstack([rates, rates[-1:]]), rows[:, 0]])
        north = self.gimbal_from_north
        return tuple(GimbalState(Attitude(*row), north, north) for row in parts.tolist())

    def _turns(self, is_placed: bool) -> tuple[Vector, AngularRates]:
        """Return rows (roll, pitch, yaw, body rates, time), and the gyro's rates."""
        attitudes = _table(self.attitudes, 4)
        rates = _table(self.attitude_rates, 3)
        if len(rates) != len(attitudes):
            rates = np.full((len(attitudes), 3), math.nan)
        both = _clean(np.hstack([attitudes, np.nan_to_num(rates, nan=math.inf)]), 4)
        if len(both) < _LEAST_SAMPLES and self.places and is_placed:
            return np.empty((0, 7)), AngularRates(np.empty(0), np.empty(0), np.empty((0, 3)))
        if len(both) < _LEAST_SAMPLES:
            raise TelemetryError("there is no attitude in this log, or just one whose time rises")
        rates = both[:, 4:] if np.isfinite(both[:, 4:]).all() else body_rates(both[:, :4])
        gyro = _clean(_table(self.gyro, 4), 4)
        if len(gyro) >= _LEAST_SAMPLES:
            rates = np.column_stack([np.interp(both[:, 0], gyro[:, 0], g) for g in gyro[:, 1:].T])
        else:
            gyro = np.column_stack([both[:, 0], rates])
        parts = np.column_stack([both[:, 1:4], rates, both[:, 0]])
        return parts, AngularRates.of_samples(gyro[:, 0], gyro[:, 1:])


def body_rates(attitudes: Vector) -> Vector:
    """Return body rates by differences, (N, 3), of rows (time, roll, pitch, yaw), (N, 4)."""
    time, angles = attitudes[:, 0], np.unwrap(attitudes[:, 1:], axis=0)
    roll_rate, pitch_rate, yaw_rate = np.gradient(angles, time, axis=0).T
    roll, pitch = angles[:, 0], angles[:, 1]
    turn = yaw_rate * np.cos(pitch)
    return np.column_stack(
        [
            roll_rate - yaw_rate * np.sin(pitch),
            pitch_rate * np.cos(roll) + turn * np.sin(roll),
            turn * np.cos(roll) - pitch_rate * np.sin(roll),
        ]
    )


def _turning(time_s: Vector, turns: Vector) -> Vector:
    """Return mean body rates, (N - 1, 3), between orientations body to world, (N, 3, 3)."""
    step = np.swapaxes(turns[:-1], 1, 2) @ turns[1:]
    axis = np.column_stack([step[:, 2, 1], step[:, 0, 2], step[:, 1, 0]])
    axis -= np.column_stack([step[:, 1, 2], step[:, 2, 0], step[:, 0, 1]])
    sine = np.linalg.norm(axis, axis=1) / 2
    angle = np.arctan2(sine, (np.trace(step, axis1=1, axis2=2) - 1) / 2)
    scale = angle / np.maximum(2 * sine, 1e-12) / np.diff(time_s)
    return np.asarray(axis * scale[:, None], np.float64)


def _euler(turns: Vector) -> Vector:
    """Return (roll, pitch, yaw), (N, 3), of orientations body to world, (N, 3, 3)."""
    roll = np.arctan2(turns[:, 2, 1], turns[:, 2, 2])
    pitch = np.arcsin(np.clip(-turns[:, 2, 0], -1, 1))
    return np.column_stack([roll, pitch, np.arctan2(turns[:, 1, 0], turns[:, 0, 0])])


def _table(rows: list[tuple[float, ...]], columns: int) -> Vector:
    return np.array(rows, np.float64).reshape(-1, columns)


def _clean(rows: Vector, columns: int) -> Vector:
    """Return the rows whose first columns are finite and whose time moves on.

    Raises:
        TelemetryError: they last for longer than a day, which no flight does.
    """
    finite = rows[np.isfinite(rows[:, :columns]).all(axis=1)]
    if not len(finite):
        return finite
    newest = np.maximum.accumulate(finite[:, 0])
    if newest[-1] - newest[0] > _LONGEST_S:
        raise TelemetryError(
            f"its times go from {newest[0]:.10g} s to {newest[-1]:.10g} s, more than a day: are "
            "they in seconds? Take out what is wrong, or of another flight"
        )
    later = np.append(True, finite[1:, 0] > newest[:-1])
    return np.asarray(finite[later], np.float64)


_BEFORE_S = 1.0
_RECORDED = "recorded"

SampleT = TypeVar("SampleT", Attitude, LocalPosition, ModeChange, GimbalState)


class TelemetryPlayback:
    """Hands out telemetry in the order of time.

    Somebody else flew: the vehicle is taken to allow following all the time, whatever its mode was,
    and the link to have been alive.

    Args:
        log: with times on the clock of the video.
        start_s: what is older than a second before it is left out.
    """

    def __init__(self, log: TelemetryLog, start_s: float) -> None:
        oldest_s = start_s - _BEFORE_S
        self._attitudes = deque(one for one in log.attitudes if one.time_s >= oldest_s)
        self._positions = deque(log.positions)
        self._modes = deque(log.modes)
        self._gimbals = deque(log.gimbals)
        self._state = VehicleState(
            mode=_RECORDED, obeys_setpoints=True, armed=True, origin=log.origin
        )

    def until(self, now_s: float) -> tuple[VehicleState, Sequence[Attitude]]:
        """Return the newest of everything at `now_s`, and the attitudes since the last call."""
        attitudes = _taken(self._attitudes, now_s)
        positions, modes = _taken(self._positions, now_s), _taken(self._modes, now_s)
        gimbals = _taken(self._gimbals, now_s)
        state = replace(self._state, heartbeat_s=now_s)
        if attitudes:
            state = replace(state, attitude=attitudes[-1])
        if positions:
            state = replace(state, position=positions[-1])
        if gimbals:
            state = replace(state, gimbal=gimbals[-1])
        if modes:
            state = replace(state, mode=modes[-1].mode or _RECORDED)
        self._state = state
        return state, attitudes


def _taken(samples: deque[SampleT], now_s: float) -> list[SampleT]:
    """Take and return the samples up to `now_s`."""
    taken = []
    while samples and samples[0].time_s <= now_s:
        taken.append(samples.popleft())
    return taken
