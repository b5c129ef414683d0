"""Two logs of one flight side by side: what is different, since when, and by how much."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from follower.flight.log import FlightLog
from follower.recording import RecordedFlight, VideoKind
from follower.recording.config import machine_differences
from follower.report.series import Array
from follower.ui.terminal.console import print_line


@dataclass(frozen=True, slots=True)
class Quantity:
    """One thing that is compared.

    Attributes:
        name: for the table.
        unit: of its numbers, "" if it has none.
        path: of attributes that lead to it from a record.
        place: in a list of numbers at the path's end, None if it is none.
    """

    name: str
    unit: str
    path: str
    place: int | None = None

    def of(self, record: Any) -> Any:
        """Return it, None where there is none, which is compared too."""
        for attribute in self.path.split("."):
            record = None if record is None else getattr(record, attribute)
        value = record if record is None or self.place is None else record[self.place]
        return float(value) if isinstance(value, np.number) else value


_COMPONENTS = (("forward", "m/s"), ("right", "m/s"), ("down", "m/s"), ("yaw rate", "rad/s"))
TRACK_QUANTITIES = (
    Quantity("track: state", "", "track.state"),
    Quantity("track: centre x", "px", "track.box.cx"),
    Quantity("track: centre y", "px", "track.box.cy"),
    Quantity("track: width", "px", "track.box.width"),
    Quantity("track: height", "px", "track.box.height"),
    Quantity("track: confidence", "", "track.confidence"),
    Quantity("track: produced by", "", "track.produced_by"),
)
CONTROL_QUANTITIES = (
    Quantity("state", "", "state"),
    Quantity("reason", "", "reason"),
    Quantity("estimate: azimuth", "rad", "estimate.azimuth_rad"),
    Quantity("estimate: elevation", "rad", "estimate.elevation_rad"),
    Quantity("estimate: log scale", "", "estimate.log_scale"),
    Quantity("estimate: azimuth rate", "rad/s", "estimate.azimuth_rate_rad_s"),
    Quantity("estimate: elevation rate", "rad/s", "estimate.elevation_rate_rad_s"),
    Quantity("estimate: log scale rate", "1/s", "estimate.log_scale_rate_s"),
    Quantity("estimate: covariance", "", "estimate.covariance"),
    *(
        Quantity(f"{which}: {name}", unit, f"{which}.values", place)
        for which in ("asked", "allowed")
        for place, (name, unit) in enumerate(_COMPONENTS)
    ),
    Quantity("gimbal: pitch rate", "rad/s", "gimbal.pitch_rad_s"),
    Quantity("gimbal: yaw rate", "rad/s", "gimbal.yaw_rad_s"),
    Quantity("limits", "", "limits"),
    Quantity("sent", "", "sent"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """How one quantity differs.

    Attributes:
        name: of the quantity.
        unit: of its numbers.
        is_number: False for names and flags, where an amount has no meaning.
        times_s: of all records compared, shape (N,).
        amounts: by how much each differs, shape (N,): 0 where it is the same to the last bit,
            infinite where it is no number or missing on one side.
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

    def agrees(self, tolerance: float) -> bool:
        """Return whether no number differs by more than a tolerance, and nothing else at all."""
        return all(one.largest <= tolerance for one in self.differing)

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
    values = [(quantity.of(a), quantity.of(b)) for a, b in pairs]
    amounts = [difference(a, b) for a, b in values]
    return Difference(
        quantity.name,
        quantity.unit,
        any(isinstance(part, float | np.ndarray) for pair in values for part in pair),
        np.array(times_s, np.float64),
        np.array(amounts, np.float64),
    )


def difference(a: Any, b: Any) -> float:
    """Return by how much two values differ: 0 means the same bits, or both NaN.

    It is infinite where no number says how much: one of the two is missing, or they are names.
    """
    if isinstance(a, np.ndarray) and isinstance(b, np.ndarray):
        pairs = zip(a.ravel().tolist(), b.ravel().tolist(), strict=True)
        return max((difference(x, y) for x, y in pairs), default=0.0)
    if isinstance(a, float) and isinstance(b, float):
        if a == b or (math.isnan(a) and math.isnan(b)):
            return 0.0
        apart = abs(a - b)
        return apart if math.isfinite(apart) else math.inf
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return math.inf  # one of them has none
    return 0.0 if a == b else math.inf


_GROWTH_S = (1.0, 5.0)
_ELSEWHERE = 1e-9
"""By how much control's numbers may differ on another kind of machine, which rounds otherwise."""


@dataclass(frozen=True, slots=True)
class Strictness:
    """How strictly a replay is compared.

    Attributes:
        differences: of this machine from the one of the recording, in words.
    """

    differences: tuple[str, ...]

    @classmethod
    def of(cls, flight: RecordedFlight) -> Strictness:
        """Return bit for bit on the same kind of machine with the same versions, else not."""
        config = flight.config
        return cls(tuple(machine_differences(config.versions, config.processor)))

    @property
    def is_exact(self) -> bool:
        """Whether every bit counts."""
        return not self.differences

    @property
    def tolerance(self) -> float:
        """The largest difference of a number that is none."""
        return 0.0 if self.is_exact else _ELSEWHERE

    def __str__(self) -> str:
        """Return it as in "compared ..."."""
        return "bit for bit" if self.is_exact else f"within {_ELSEWHERE:g}"

    @property
    def why(self) -> str:
        """A sentence for the terminal."""
        reason = "; ".join(self.differences) or "recorded on this kind of machine, same versions"
        return f"Compared {self}: {reason}."


def pictures_are_exact(flight: RecordedFlight) -> bool:
    """Return whether the video holds what vision saw, bit for bit.

    It does if it is lossless; and if the flight is itself a saved replay, whose tracks were made
    from these decoded pictures.
    """
    if "tracks_from" in flight.config.run:
        return True
    return bool(flight.config.group("recorder").get("video") == VideoKind.LOSSLESS)


def print_comparison(
    console: Console, title: str, parts: tuple[Difference, ...], tolerance: float = 0.0
) -> None:
    """Print a table of what differs, or a line that nothing does by more than a tolerance."""
    compared = max((len(one.times_s) for one in parts), default=0)
    differing = [one for one in parts if one.count]
    if not differing:
        print_line(console, f"{title}: {compared} compared{', identical' if compared else ''}")
        return
    largest = max(one.largest for one in differing)
    if largest <= tolerance:
        same = f"the same within {tolerance:g} (the largest difference is {largest:.1e})"
        print_line(console, f"{title}: {compared} compared, {same}")
        return
    print_line(console, f"{title}: {compared} compared, these differ:")
    table = Table()
    table.add_column("what", no_wrap=True)
    for heading in ("differ", "first at", *(f"after {s:g} s" for s in _GROWTH_S), "largest"):
        table.add_column(heading, justify="right")
    for one in differing:
        first_s = one.first_s or 0.0
        amounts = [*(one.largest_until(first_s + after_s) for after_s in _GROWTH_S), one.largest]
        shown = [_amount(value, one.unit) if one.is_number else "–" for value in amounts]
        table.add_row(one.name, str(one.count), f"{first_s:.3f} s", *shown)
    console.print(table)


def _amount(value: float, unit: str) -> str:
    return f"{value:.2g} {unit}" if math.isfinite(value) else "missing"


def first_difference(comparison: Comparison) -> str:
    """Return one line about where it begins, "" if it does not."""
    first_s = comparison.first_s
    if first_s is None:
        return ""
    names = [one.name for one in comparison.differing if one.first_s == first_s]
    return f"The first difference is at {first_s:.3f} s: {', '.join(names)}."
