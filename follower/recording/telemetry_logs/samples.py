"""What all kinds of telemetry logs come down to."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self, TypeVar

import numpy as np

from follower_control.common.clock_offset import AngularRates
from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState
from follower_vision.geometry.camera_model import Vector
from follower_vision.sources.frame_source import SourceError

_LEAST_SAMPLES = 2


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
        attitudes: at least two.
        rates: the gyro's, or those that come with the attitudes.
        positions: local positions; none if the log has none.
        modes: changes of mode; none if the log has none.
    """

    attitudes: tuple[Attitude, ...]
    rates: AngularRates
    positions: tuple[LocalPosition, ...] = ()
    modes: tuple[ModeChange, ...] = ()

    @property
    def start_s(self) -> float:
        """The first attitude's time."""
        return self.attitudes[0].time_s

    @property
    def end_s(self) -> float:
        """The last attitude's time."""
        return self.attitudes[-1].time_s

    @property
    def rate_hz(self) -> float:
        """Attitudes a second."""
        return (len(self.attitudes) - 1) / max(self.end_s - self.start_s, 1e-9)

    def moved(self, by_s: float) -> Self:
        """Return the same with `by_s` seconds added to all times."""
        rates = self.rates
        return replace(
            self,
            attitudes=tuple(replace(one, time_s=one.time_s + by_s) for one in self.attitudes),
            rates=AngularRates(rates.start_s + by_s, rates.end_s + by_s, rates.rates_rad_s),
            positions=tuple(replace(one, time_s=one.time_s + by_s) for one in self.positions),
            modes=tuple(replace(one, time_s=one.time_s + by_s) for one in self.modes),
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
    """

    attitudes: list[tuple[float, ...]] = field(default_factory=list)
    attitude_rates: list[tuple[float, ...]] = field(default_factory=list)
    gyro: list[tuple[float, ...]] = field(default_factory=list)
    positions: list[tuple[float, ...]] = field(default_factory=list)
    modes: list[ModeChange] = field(default_factory=list)

    def add_mode(self, time_s: float, mode: str, armed: bool) -> None:
        """Note a mode at a time in seconds, if it is another one than before."""
        newest = self.modes[-1] if self.modes else None
        if newest is None or (newest.mode, newest.armed) != (mode, armed):
            self.modes.append(ModeChange(time_s, mode, armed))

    def log(self, named: str) -> TelemetryLog:
        """Return the log, without rows that are not finite or not later than the one before.

        Args:
            named: the file, for messages.

        Raises:
            TelemetryError: there are fewer than two attitudes.
        """
        attitudes = _table(self.attitudes, 4)
        rates = _table(self.attitude_rates, 3)
        if len(rates) != len(attitudes):
            rates = np.full((len(attitudes), 3), math.nan)
        both = _clean(np.hstack([attitudes, np.nan_to_num(rates, nan=math.inf)]), 4)
        if len(both) < _LEAST_SAMPLES:
            raise TelemetryError(f"{named}: there is no attitude in this log, or just one")
        rates = both[:, 4:] if np.isfinite(both[:, 4:]).all() else body_rates(both[:, :4])
        gyro = _clean(_table(self.gyro, 4), 4)
        if len(gyro) >= _LEAST_SAMPLES:
            rates = np.column_stack([np.interp(both[:, 0], gyro[:, 0], g) for g in gyro[:, 1:].T])
        else:
            gyro = np.column_stack([both[:, 0], rates])
        parts = np.column_stack([both[:, 1:4], rates, both[:, 0]])
        places = _clean(_table(self.positions, 7), 7)
        return TelemetryLog(
            tuple(Attitude(*row) for row in parts.tolist()),
            AngularRates.of_samples(gyro[:, 0], gyro[:, 1:]),
            tuple(LocalPosition(*row) for row in np.roll(places, -1, axis=1).tolist()),
            tuple(sorted(self.modes, key=lambda one: one.time_s)),
        )


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


def _table(rows: list[tuple[float, ...]], columns: int) -> Vector:
    return np.array(rows, np.float64).reshape(-1, columns)


def _clean(rows: Vector, columns: int) -> Vector:
    """Return the rows whose first columns are finite and whose time moves on."""
    finite = rows[np.isfinite(rows[:, :columns]).all(axis=1)]
    if not len(finite):
        return finite
    newest = np.maximum.accumulate(finite[:, 0])
    later = np.append(True, finite[1:, 0] > newest[:-1])
    return np.asarray(finite[later], np.float64)


_BEFORE_S = 1.0
_RECORDED = "recorded"

SampleT = TypeVar("SampleT", Attitude, LocalPosition, ModeChange)


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
        self._attitudes = [one for one in log.attitudes if one.time_s >= oldest_s]
        self._positions = list(log.positions)
        self._modes = list(log.modes)
        self._state = VehicleState(mode=_RECORDED, obeys_setpoints=True, armed=True)

    def until(self, now_s: float) -> tuple[VehicleState, Sequence[Attitude]]:
        """Return the newest of everything at `now_s`, and the attitudes since the last call."""
        attitudes = _taken(self._attitudes, now_s)
        positions, modes = _taken(self._positions, now_s), _taken(self._modes, now_s)
        state = replace(self._state, heartbeat_s=now_s)
        if attitudes:
            state = replace(state, attitude=attitudes[-1])
        if positions:
            state = replace(state, position=positions[-1])
        if modes:
            state = replace(state, mode=modes[-1].mode or _RECORDED)
        self._state = state
        return state, attitudes


def _taken(samples: list[SampleT], now_s: float) -> list[SampleT]:
    """Take and return the samples up to `now_s`."""
    count = next((n for n, one in enumerate(samples) if one.time_s > now_s), len(samples))
    taken = samples[:count]
    del samples[:count]
    return taken
