"""What all kinds of telemetry logs come down to."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from follower_control.timeoffset import AngularRates
from follower_control.vehicle import Attitude, LocalPosition
from follower_vision.camera import Vector
from follower_vision.framesource import SourceError

_LEAST_SAMPLES = 2


class TelemetryError(SourceError):
    """A telemetry log cannot be used; the message says which, why and what would do."""


@dataclass(frozen=True, slots=True)
class ModeChange:
    """From `time_s` on the vehicle is in a mode."""

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
        """Return the same with `by_s` added to all times."""
        rates = self.rates
        return replace(
            self,
            attitudes=tuple(replace(one, time_s=one.time_s + by_s) for one in self.attitudes),
            rates=AngularRates(rates.start_s + by_s, rates.end_s + by_s, rates.rates_rad_s),
            positions=tuple(replace(one, time_s=one.time_s + by_s) for one in self.positions),
            modes=tuple(replace(one, time_s=one.time_s + by_s) for one in self.modes),
        )

    def from_its_start(self) -> Self:
        """Return the same with times counted from the first attitude."""
        return self.moved(-self.start_s)


@dataclass(slots=True)
class Samples:
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
