"""Two logs of one flight side by side: what is different, since when, and by how much."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from follower.flightlog import ControlRecord, FlightLog, TrackRecord
from follower.report.series import Array
from follower_control.estimate import TargetEstimate
from follower_control.gimbal import GimbalRates
from follower_vision.track import Track


@dataclass(frozen=True, slots=True)
class Quantity:
    """One thing that is compared.

    Attributes:
        name: for the table.
        unit: of its numbers, "" if it has none.
        get: takes it from a record; None where there is none, which is compared too.
    """

    name: str
    unit: str
    get: Callable[[Any], Any]


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """How one quantity differs.

    Attributes:
        name: of the quantity.
        unit: of its numbers.
        is_number: False for names and flags, where an amount has no meaning.
        times_s: of all records compared, shape (N,).
        amounts: by how much each differs, shape (N,): 0 where it is the same to the last bit,
            1 where it is no number or missing on one side.
    """

    name: str
    unit: str
    is_number: bool
    times_s: Array
    amounts: Array

    @property
    def count(self) -> int:
        """How many records differ."""
        return int(np.count_nonzero(self.amounts))

    @property
    def first_s(self) -> float | None:
        """When the first one differs, None if none does."""
        where = np.flatnonzero(self.amounts)
        return float(self.times_s[where[0]]) if len(where) else None

    @property
    def largest(self) -> float:
        """The largest difference."""
        return float(self.amounts.max(initial=0.0))

    def largest_until(self, time_s: float) -> float:
        """Return the largest difference up to a time."""
        return float(self.amounts[self.times_s <= time_s].max(initial=0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """How two logs differ.

    Attributes:
        tracks: of vision's answers.
        control: of estimates, decisions and setpoints.
    """

    tracks: tuple[Difference, ...]
    control: tuple[Difference, ...]

    @property
    def differing(self) -> tuple[Difference, ...]:
        """Those that are not the same throughout."""
        return tuple(one for one in (*self.tracks, *self.control) if one.count)

    @property
    def identical(self) -> bool:
        """Whether everything is the same to the last bit."""
        return not self.differing

    @property
    def first_s(self) -> float | None:
        """When the first difference is, None if there is none."""
        return min((one.first_s for one in self.differing if one.first_s is not None), default=None)


def compare(recorded: FlightLog, replayed: FlightLog) -> Comparison:
    """Compare every track, estimate and setpoint.

    Tracks belong together by their frames' numbers, control steps by their order. A frame that the
    replay did not get is not compared. How long things took is no part of it.
    """
    answers = {record.sequence: record for record in replayed.tracks}
    both = [record for record in recorded.tracks if record.sequence in answers]
    pairs = [(record, answers[record.sequence]) for record in both]
    track_times = [record.captured_s for record in both]
    steps = list(zip(recorded.controls, replayed.controls, strict=True))
    step_times = [record.time_s for record in recorded.controls]
    return Comparison(
        tuple(_difference(one, track_times, pairs) for one in TRACK_QUANTITIES),
        tuple(_difference(one, step_times, steps) for one in CONTROL_QUANTITIES),
    )


def _difference(
    quantity: Quantity, times_s: Sequence[float], pairs: Iterable[tuple[Any, Any]]
) -> Difference:
    def value(record: Any) -> Any:
        return None if record is None else quantity.get(record)

    values = [(value(a), value(b)) for a, b in pairs]
    amounts = [difference(a, b) for a, b in values]
    return Difference(
        quantity.name,
        quantity.unit,
        any(isinstance(part, float | np.ndarray) for pair in values for part in pair),
        np.array(times_s, np.float64),
        np.array(amounts, np.float64),
    )


def difference(a: Any, b: Any) -> float:
    """Return by how much two values differ: 0 means the same bits, or both NaN."""
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        pairs = zip(a.ravel().tolist(), b.ravel().tolist(), strict=True)
        return max((difference(x, y) for x, y in pairs), default=0.0)
    if isinstance(a, float) and isinstance(b, float):
        if a == b or (math.isnan(a) and math.isnan(b)):
            return 0.0
        apart = abs(a - b)
        return apart if math.isfinite(apart) else 1.0
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return 1.0  # one of them has none
    return 0.0 if a == b else 1.0


def _of_track(get: Callable[[Track], Any]) -> Callable[[TrackRecord], Any]:
    return lambda record: None if record.track is None else get(record.track)


def _of_estimate(get: Callable[[TargetEstimate], Any]) -> Callable[[ControlRecord], Any]:
    return lambda record: None if record.estimate is None else get(record.estimate)


def _of_gimbal(get: Callable[[GimbalRates], float]) -> Callable[[ControlRecord], Any]:
    return lambda record: None if record.gimbal is None else get(record.gimbal)


def _component(which: str, place: int) -> Callable[[ControlRecord], Any]:
    return lambda record: getattr(record, which).values[place]


_COMPONENTS = (("forward", "m/s"), ("right", "m/s"), ("down", "m/s"), ("yaw rate", "rad/s"))
TRACK_QUANTITIES = (
    Quantity("track: state", "", _of_track(lambda track: str(track.state))),
    Quantity("track: centre x", "px", _of_track(lambda track: float(track.box.cx))),
    Quantity("track: centre y", "px", _of_track(lambda track: float(track.box.cy))),
    Quantity("track: width", "px", _of_track(lambda track: float(track.box.width))),
    Quantity("track: height", "px", _of_track(lambda track: float(track.box.height))),
    Quantity("track: confidence", "", _of_track(lambda track: float(track.confidence))),
    Quantity("track: produced by", "", _of_track(lambda track: track.produced_by)),
)
CONTROL_QUANTITIES = (
    Quantity("state and reason", "", lambda record: (str(record.state), str(record.reason))),
    Quantity("estimate: azimuth", "rad", _of_estimate(lambda one: one.azimuth_rad)),
    Quantity("estimate: elevation", "rad", _of_estimate(lambda one: one.elevation_rad)),
    Quantity("estimate: log scale", "", _of_estimate(lambda one: one.log_scale)),
    Quantity("estimate: azimuth rate", "rad/s", _of_estimate(lambda one: one.azimuth_rate_rad_s)),
    Quantity(
        "estimate: elevation rate", "rad/s", _of_estimate(lambda one: one.elevation_rate_rad_s)
    ),
    Quantity("estimate: log scale rate", "1/s", _of_estimate(lambda one: one.log_scale_rate_s)),
    Quantity("estimate: covariance", "", _of_estimate(lambda one: one.covariance)),
    *(
        Quantity(f"{which}: {name}", unit, _component(which, place))
        for which in ("asked", "allowed")
        for place, (name, unit) in enumerate(_COMPONENTS)
    ),
    Quantity("gimbal: pitch rate", "rad/s", _of_gimbal(lambda one: one.pitch_rad_s)),
    Quantity("gimbal: yaw rate", "rad/s", _of_gimbal(lambda one: one.yaw_rad_s)),
    Quantity("limits", "", lambda record: tuple(map(str, record.limits))),
    Quantity("sent", "", lambda record: record.sent),
)
