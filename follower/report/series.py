"""A flight's log as arrays to plot. A NaN in them is a gap in the curve and nothing else."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from follower.flight.log import ControlRecord, FlightLog, TrackRecord, setpoint_delays
from follower.flight.supervision.flight_end import FlightEnd
from follower.flight.supervision.supervisor import SupervisorState
from follower_control.servo.settings import RangeFrom, ServoSettings
from follower_control.target.estimate import azimuth_of, ranged_by_ground
from follower_control.target.observation import BearingFrame
from follower_control.vehicle.state import VehicleState
from follower_sim.kinematics import TruthSample
from follower_sim.scoring.score import PursuitGoal, PursuitScore
from follower_vision.geometry.line_of_sight import wrap_angle

Array = npt.NDArray[np.float64]

_NAN = math.nan
_OLDEST_S = 0.3


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of time in which a state did not change; times since the flight's start."""

    start_s: float
    end_s: float
    state: str
    reason: str

    @property
    def length_s(self) -> float:
        """How many seconds it lasted."""
        return self.end_s - self.start_s


@dataclass(frozen=True, slots=True)
class VehicleMotion:
    """How the vehicle moved, shape (N,) or as said.

    Attributes:
        time_s: since the flight's start.
        velocity: (N, 4): forward, right, up in m/s, yaw rate in deg/s.
        tilt_deg: (N, 2): roll, pitch.
        position_m: (N, 3): north, east, up.
    """

    time_s: Array
    velocity: Array
    tilt_deg: Array
    position_m: Array


def control_times(controls: Sequence[ControlRecord], start_s: float) -> Array:
    """Return the steps' times, shape (N,)."""
    return np.array([record.time_s - start_s for record in controls], np.float64)


def setpoints(controls: Sequence[ControlRecord], name: str) -> Array:
    """Return "asked" or "allowed", (N, 4): forward, right, up in m/s, yaw rate in deg/s."""
    rows = [getattr(record, name).values for record in controls]
    return _table(rows, 4) * (1.0, 1.0, -1.0, math.degrees(1.0))


def directions(controls: Sequence[ControlRecord]) -> Array:
    """Return the estimate's (azimuth, elevation) from the nose in degrees, (N, 2)."""
    return np.degrees(_table([_direction(record) for record in controls], 2))


def believed_ranges(controls: Sequence[ControlRecord], servo: ServoSettings | None) -> Array:
    """Return the range that the servo goes by, metres, shape (N,): by the ground, or a size.

    Where no size is given it is the one that fits to the wanted distance when it first follows.
    """
    if servo is None:
        return np.full(len(controls), _NAN)
    size_m = servo.target_size_m
    first = next((one.estimate for one in controls if one.estimate and one.state.steers), None)
    if size_m is None and first is not None:
        size_m = servo.distance_m * math.exp(first.log_scale)
    return np.array([_believed_range(one, servo, size_m) for one in controls], np.float64)


def _believed_range(record: ControlRecord, servo: ServoSettings, size_m: float | None) -> float:
    estimate, height_m = record.estimate, record.vehicle.above_ground_m(record.time_s)
    if estimate is None:
        return _NAN
    if servo.range_from is RangeFrom.GROUND and height_m is not None:
        ranged = ranged_by_ground(estimate, 1.0, height_m - servo.target_middle_m, 0.0)
        if ranged is not estimate:
            return math.exp(-ranged.log_scale)
    return _NAN if size_m is None else size_m / math.exp(estimate.log_scale)


def estimated_target(controls: Sequence[ControlRecord], servo: ServoSettings | None) -> Array:
    """Return where the target stood by the estimate and the vehicle's position, (N, 2).

    North and east in metres on the autopilot's local origin. It is as good as the range is. NaN
    where nothing is known or the target has not been seen for 0.3 s.
    """
    ranges = believed_ranges(controls, servo)
    rows = [_target_place(record) for record in controls]
    table = _table(rows, 4)
    return table[:, :2] + ranges[:, None] * table[:, 2:]


def telemetry_motion(controls: Sequence[ControlRecord], start_s: float) -> VehicleMotion:
    """Return the motion as telemetry reports it (m, m/s, NED); times from `start_s`."""
    rows = [_telemetry_row(record.vehicle) for record in controls]
    return _motion(control_times(controls, start_s), rows)


def true_motion(truth: Sequence[TruthSample], start_s: float) -> VehicleMotion:
    """Return the motion as the simulator knows it (m, m/s, NED); times from `start_s`."""
    bodies = [sample.vehicle for sample in truth]
    rows = [(*b.attitude_rad, *b.rates_rad_s, *b.position_m, *b.velocity_m_s) for b in bodies]
    return _motion(np.array([sample.time_s - start_s for sample in truth], np.float64), rows)


def boxes(tracks: Sequence[TrackRecord]) -> Array:
    """Return (centre x, centre y, scale) in pixels and confidence, shape (N, 4)."""
    rows = [
        (r.track.box.cx, r.track.box.cy, r.track.box.scale, r.track.confidence)
        if r.track is not None
        else (_NAN,) * 4
        for r in tracks
    ]
    return _table(rows, 4)


def state_spans(controls: Sequence[ControlRecord], start_s: float) -> list[Span]:
    """Return the supervisor's states, joined where state and reason stay the same."""
    return _spans((r.time_s - start_s, str(r.state), str(r.reason)) for r in controls)


def track_spans(tracks: Sequence[TrackRecord], start_s: float) -> list[Span]:
    """Return vision's states by capture time; "none" while no target is chosen."""
    return _spans(
        (r.captured_s - start_s, "none" if r.track is None else str(r.track.state), "")
        for r in tracks
    )


@dataclass(frozen=True, slots=True)
class Timing:
    """One measured time over the flight.

    Attributes:
        name: what was measured.
        values_s: each measurement, seconds.
    """

    name: str
    values_s: Array

    def percentile_ms(self, percent: float) -> float:
        """Return a percentile in milliseconds.

        Raises:
            IndexError: nothing was measured.
        """
        return 1e3 * float(np.percentile(self.values_s, percent))


def timings(log: FlightLog) -> list[Timing]:
    """Return the four times that matter, those that were measured at all.

    On a simulated clock nothing is ever late: then there is no lateness to speak of.
    """
    late_s = [record.late_s for record in log.controls]
    rows = [
        ("control: lateness", late_s if any(late_s) else []),
        ("control: one step's work", [record.busy_s for record in log.controls]),
        ("vision: one frame's work", [record.busy_s for record in log.tracks]),
        ("capture to setpoint", list(setpoint_delays(log.controls).values())),
    ]
    return [Timing(name, np.array(values, np.float64)) for name, values in rows if values]


def thinned(time: Array, values: Array, most: int = 1600) -> tuple[Array, Array]:
    """Return at most about `most` points of a curve: each bin's smallest and largest value."""
    if len(time) <= most:
        return time, values
    size = math.ceil(2 * len(time) / most)
    index = np.arange(math.ceil(len(time) / size) * size).clip(max=len(time) - 1).reshape(-1, size)
    known = np.isfinite(values[index])
    low = np.where(known, values[index], np.inf).argmin(axis=1)
    high = np.where(known, values[index], -np.inf).argmax(axis=1)
    rows = np.arange(len(index))
    kept = np.unique(np.concatenate([index[rows, low], index[rows, high]]))
    return time[kept], values[kept]


def _direction(record: ControlRecord) -> tuple[float, float]:
    estimate, attitude = record.estimate, record.vehicle.attitude
    if estimate is None:
        return _NAN, _NAN
    azimuth_rad, elevation_rad = azimuth_of(estimate), estimate.height_angle_rad
    if estimate.frame is BearingFrame.BODY:
        return azimuth_rad, elevation_rad
    if attitude is None:
        return _NAN, _NAN
    return wrap_angle(azimuth_rad - attitude.yaw_rad), elevation_rad


def _target_place(record: ControlRecord) -> tuple[float, ...]:
    """Return the vehicle's place and the horizontal direction to the target."""
    estimate, position = record.estimate, record.vehicle.position
    known = estimate is not None and estimate.frame is not BearingFrame.BODY
    if estimate is None or not known or position is None or estimate.age_s > _OLDEST_S:
        return (_NAN,) * 4
    north, east, _ = estimate.direction.tolist()
    return position.north_m, position.east_m, north, east


def _telemetry_row(vehicle: VehicleState) -> tuple[float, ...]:
    """Return (roll, pitch, yaw, p, q, r, position and velocity north, east, down)."""
    unknown = (_NAN,) * 6
    attitude = unknown if vehicle.attitude is None else vehicle.attitude.numbers
    return attitude + (unknown if vehicle.position is None else vehicle.position.numbers)


def _motion(time_s: Array, rows: Sequence[tuple[float, ...]]) -> VehicleMotion:
    table = _table(rows, 12)
    roll, pitch, yaw = table[:, 0], table[:, 1], table[:, 2]
    q, r = table[:, 4], table[:, 5]
    north, east, down = table[:, 9], table[:, 10], table[:, 11]
    forward = np.cos(yaw) * north + np.sin(yaw) * east
    right = np.cos(yaw) * east - np.sin(yaw) * north
    # The heading's rate, not the body's: they differ while the vehicle is tilted.
    turn = (q * np.sin(roll) + r * np.cos(roll)) / np.cos(pitch)
    return VehicleMotion(
        time_s,
        np.column_stack([forward, right, -down, np.degrees(turn)]),
        np.degrees(table[:, :2]),
        table[:, 6:9] * (1.0, 1.0, -1.0),
    )


def _table(rows: Sequence[tuple[float, ...]], columns: int) -> Array:
    return np.array(rows, np.float64).reshape(-1, columns)


def _spans(samples: Iterable[tuple[float, str, str]]) -> list[Span]:
    spans: list[Span] = []
    for time_s, state, reason in samples:
        if spans and (spans[-1].state, spans[-1].reason) == (state, reason):
            spans[-1] = Span(spans[-1].start_s, time_s, state, reason)
            continue
        if spans:
            spans[-1] = Span(spans[-1].start_s, time_s, spans[-1].state, spans[-1].reason)
        spans.append(Span(time_s, time_s, state, reason))
    return spans


@dataclass(slots=True)
class LoggedFlight:
    """A flight's log with the truth, if there is one; times count from `start_s`.

    Attributes:
        log: what happened.
        truth: the simulator's samples, empty for a real flight or a recording.
        goal: what was wanted, None if that is unknown.
        servo: its settings, by which ranges are believed; None if they are unknown.
        score: what the flight is worth, None without truth.
        start_s: when the flight began, seconds on the system's clock.
        length_s: from then to its last.
        states: the supervisor's states.
        seen: vision's states.
        motion: the vehicle's true motion, or what telemetry says of it.
        approached_s: when the approach was over, None if it never was or nobody knows.
    """

    log: FlightLog
    truth: Sequence[TruthSample] = ()
    goal: PursuitGoal | None = None
    servo: ServoSettings | None = None
    score: PursuitScore | None = None
    start_s: float = field(init=False)
    length_s: float = field(init=False)
    states: list[Span] = field(init=False)
    seen: list[Span] = field(init=False)
    motion: VehicleMotion = field(init=False)
    approached_s: float | None = field(init=False)

    def __post_init__(self) -> None:
        log, truth = self.log, self.truth
        self.start_s, end_s = _time_range(log, truth)
        self.length_s = max(0.0, end_s - self.start_s)
        self.states = state_spans(log.controls, self.start_s)
        self.seen = track_spans(log.tracks, self.start_s)
        reported = telemetry_motion(log.controls, self.start_s)
        self.motion = true_motion(truth, self.start_s) if truth else reported
        self.approached_s = self._approach_end_s()

    def _approach_end_s(self) -> float | None:
        if self.score is None or self.score.approach_s is None:
            return None
        following = (r for r in self.log.controls if r.state is SupervisorState.FOLLOWING)
        first = next(following, None)
        return None if first is None else first.time_s - self.start_s + self.score.approach_s


def _time_range(log: FlightLog, truth: Sequence[TruthSample]) -> tuple[float, float]:
    """Return the log's earliest and latest time in seconds, twice 0 for an empty one."""
    times = [record.time_s for record in (*log.controls[:1], *log.controls[-1:])]
    times += [record.captured_s for record in (*log.tracks[:1], *log.tracks[-1:])]
    times += [event.time_s for event in (*log.events[:1], *log.events[-1:])]
    starts = [*times, *(sample.time_s for sample in truth[:1])]
    return min(starts, default=0.0), max(times, default=0.0)


@dataclass(frozen=True, slots=True)
class ReportMeta:
    """What was run, and how to run it again.

    Attributes:
        title: the page's headline, e.g. the scenario's title.
        subtitle: a line below it, e.g. autopilot, seed, lockstep or real time.
        command: the command line that does this run again.
        settings_yaml: all settings as resolved.
        facts: (name, value) pairs worth knowing: versions, machine, seed.
        files: (file name, what it is) of what else lies in the folder.
        video: the name of a video in the folder to show, "" if there is none.
        remarks: lines that the reader must know, e.g. that the flight was interrupted.
        end: how the flight ended; None leaves that to the score.
    """

    title: str
    subtitle: str = ""
    command: str = ""
    settings_yaml: str = ""
    facts: tuple[tuple[str, str], ...] = ()
    files: tuple[tuple[str, str], ...] = ()
    video: str = ""
    remarks: tuple[str, ...] = ()
    end: FlightEnd | None = None
