"""Reads what `identify` takes: folders of flights, CSV files of recorded steps, PX4 logs."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from follower.flight.log import ControlRecord, setpoint_delays
from follower.recording import RecordedFlight, open_flight
from follower.recording.telemetry_logs.readers import read_ulog
from follower.recording.telemetry_logs.samples import TelemetryError, TelemetrySamples
from follower.tuning.excite.pattern import RUN_KEY
from follower_control.servo.settings import ServoSettings
from follower_control.target.observation import BearingFrame, GateVerdict
from follower_control.tuning.rational import Array
from follower_control.tuning.response_model import ResponseData, TooLittleError
from follower_control.vehicle.state import Attitude, LocalPosition
from follower_sim.scoring.recorded_step import STEP_COLUMNS, RecordedStep


class VehicleAxis(StrEnum):
    """What a setpoint asks for."""

    FORWARD = "forward"
    RIGHT = "right"
    DOWN = "down"
    YAW_RATE = "yaw_rate"

    @property
    def is_turn(self) -> bool:
        """Whether it is in radians a second."""
        return self is VehicleAxis.YAW_RATE

    @property
    def least_excitation(self) -> float:
        """Least RMS of the setpoints that is no mere hovering; m/s or rad/s."""
        return 0.03 if self.is_turn else 0.15


@dataclass(frozen=True, slots=True)
class SizeSample:
    """The target's angular size in radians, and its range in metres by other means than size."""

    size_rad: float
    range_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What one recording contains.

    Attributes:
        name: of the file or folder.
        axes: stretches of each axis; an axis that was never asked to move may be missing.
        camera_delays_s: from each frame's capture to the first setpoint made from it.
        frame_intervals_s: from each frame to the next.
        position_ages_s: how old the newest position was at each control step.
        sizes: the target's angular size at which range.
        remarks: what could not be used, in sentences.
        is_excitation: it was flown to be identified; a pursuit seldom excites as much.
    """

    name: str
    axes: Mapping[VehicleAxis, Sequence[ResponseData]]
    camera_delays_s: Sequence[float] = ()
    frame_intervals_s: Sequence[float] = ()
    position_ages_s: Sequence[float] = ()
    sizes: Sequence[SizeSample] = ()
    remarks: Sequence[str] = ()
    is_excitation: bool = True


def is_excited(record: ResponseData, axis: VehicleAxis) -> bool:
    """Whether a stretch asks its axis to move at all."""
    inputs = record.inputs
    return bool(len(inputs) and np.ptp(inputs) > axis.least_excitation)


def in_heading(north: Array, east: Array, yaw_rad: Array) -> tuple[Array, Array]:
    """Return forward and right of what is north and east, (N,) each, in the same unit."""
    cos_yaw, sin_yaw = np.cos(yaw_rad), np.sin(yaw_rad)
    return north * cos_yaw + east * sin_yaw, east * cos_yaw - north * sin_yaw


_Telemetry = TypeVar("_Telemetry", Attitude, LocalPosition)

_LONGEST_GAP_S = 0.3
# Of CSV files
_WORLD_FRAMES = (1, 7)
_TURNING_RAD_S = 0.1
# Of flights
_USED = (GateVerdict.STARTED, GateVerdict.FUSED, GateVerdict.RESTARTED)
_LEAST_STEPS = 150
_FLATTEST_RAD = math.radians(8)
_LOWEST_M = 1.5
_APART_S = 0.5
_BEFORE_S, _AFTER_S, _QUIET = 2.0, 4.0, 0.005
# Of PX4 logs
_TOPIC = "trajectory_setpoint"
_PAUSE_S = 0.5
_LEAST_SETPOINTS = 60


def read_steps(path: Path) -> Recording:
    """Read one file.

    Raises:
        TooLittleError: it is no such file, or nothing was asked for in it.
    """
    try:
        step = RecordedStep.load(path)
    except KeyError as error:
        raise TooLittleError(
            f"no recorded steps: the column {error} is missing; needed are "
            f"{', '.join(STEP_COLUMNS)}"
        ) from None
    except (ValueError, OSError) as error:
        raise TooLittleError(f"cannot be read as recorded steps: {error}") from None
    _check_times(step.time_s)
    if len(step.sent) < 2:
        return Recording(step.name, {}, remarks=(f"{step.name}: no setpoint changes in it",))
    return Recording(step.name, _step_axes(step), remarks=())


def _check_times(time_s: Array) -> None:
    """Refuse times by which a fit would be wrong without showing it.

    Raises:
        TooLittleError: a time is missing, in another unit, or follows on a gap.
    """
    missing = np.flatnonzero(~np.isfinite(time_s))
    if len(missing):
        raise TooLittleError(f"the time is missing in row {_row(int(missing[0]))}")
    if len(time_s) < 2:
        raise TooLittleError("there is one row alone")
    steps_s = np.diff(time_s)
    usual_s = float(np.median(steps_s))
    if usual_s > _LONGEST_GAP_S:
        raise TooLittleError(
            f"there are {usual_s:g} s from row to row: t_boot is in seconds, and the fit "
            f"needs at least a row each {_LONGEST_GAP_S:g} s"
        )
    longest = int(np.argmax(steps_s))
    if steps_s[longest] > _LONGEST_GAP_S:
        raise TooLittleError(
            f"{steps_s[longest]:.2f} s are missing before row {_row(longest + 1)}: cut the "
            "file in two there"
        )


def _row(index: int) -> int:
    """Return a row's number as a spreadsheet counts, with the heading as the first one."""
    return index + 2


def _step_axes(step: RecordedStep) -> dict[VehicleAxis, list[ResponseData]]:
    asked = np.array([(*one.velocity_m_s, one.yaw_rate_rad_s) for one in step.sent]).T
    times = np.array([one.time_s for one in step.sent])
    yaw = np.interp(times, step.time_s, np.unwrap(step.attitude_rad[2]))
    if step.sent[0].frame in _WORLD_FRAMES:
        asked[0], asked[1] = in_heading(asked[0], asked[1], yaw)
    outputs = (*step.heading_velocity_m_s, step.yaw_rate_rad_s)
    turns = float(np.abs(asked[3]).max()) > _TURNING_RAD_S
    found: dict[VehicleAxis, list[ResponseData]] = {}
    for axis, inputs, output in zip(VehicleAxis, asked, outputs, strict=True):
        record = _record(step, times, inputs, output)
        # While the nose turns, a velocity in its frame is more than this axis' answer.
        if is_excited(record, axis) and (axis.is_turn or not turns):
            found[axis] = [record]
    return found


def _record(step: RecordedStep, times: Array, inputs: Array, output: Array) -> ResponseData:
    # One clock value may come twice where telemetry repeated itself.
    fresh = np.concatenate([[True], np.diff(step.time_s) > 0])
    first = np.concatenate([np.diff(times) > 0, [True]])
    name = step.name
    return ResponseData(name, times[first], inputs[first], step.time_s[fresh], output[fresh])


def read_flight(folder: Path) -> Recording:
    """Read one folder.

    Raises:
        FlightFileError: it is no flight, or cannot be read.
    """
    flight = open_flight(folder)
    controls = flight.log.controls
    stretches = [one for one in _flown(controls) if len(one) >= _LEAST_STEPS]
    axes: dict[VehicleAxis, list[ResponseData]] = {}
    for number, stretch in enumerate(stretches):
        for axis, record in _flight_axes(f"{folder.name} {number + 1}", stretch):
            if is_excited(record, axis):
                axes.setdefault(axis, []).append(record)
    remarks = list(flight.remarks)
    steps_s = [b.time_s - a.time_s for a, b in pairwise(controls)]
    if missing_s := sum(step_s for step_s in steps_s if step_s > _LONGEST_GAP_S):
        remarks.append(
            f"{folder}: {missing_s:.1f} s are missing in its log: what was flown before and after "
            "is fitted as two flights"
        )
    if not stretches:
        remarks.append(
            f"{folder}: at no time did the vehicle fly by our setpoints for "
            f"{_LEAST_STEPS} steps on end: nothing of its response can be identified"
        )
    return Recording(
        folder.name,
        axes,
        _camera_delays(flight),
        [b - a for a, b in pairwise(sorted({frame.captured_s for frame in flight.frames}))],
        [r.vehicle.position_age_s(r.time_s) for r in controls if r.vehicle.position is not None],
        _sizes(flight),
        tuple(remarks),
        RUN_KEY in flight.config.run,
    )


def _flown(controls: Iterable[ControlRecord]) -> Iterator[list[ControlRecord]]:
    """Yield the stretches, without gaps, in which the vehicle flew by our setpoints."""
    stretch: list[ControlRecord] = []
    for record in controls:
        ours = record.sent and record.state.engaged and record.vehicle.obeys_setpoints
        if stretch and not (ours and record.time_s - stretch[-1].time_s <= _LONGEST_GAP_S):
            yield stretch
            stretch = []
        if ours:
            stretch.append(record)
    if stretch:
        yield stretch


def _flight_axes(
    name: str, stretch: Sequence[ControlRecord]
) -> Iterator[tuple[VehicleAxis, ResponseData]]:
    times = np.array([record.time_s for record in stretch])
    asked = np.array([record.allowed.values for record in stretch]).T
    attitudes = _fresh(record.vehicle.attitude for record in stretch)
    positions = _fresh(record.vehicle.position for record in stretch)
    if min(len(attitudes), len(positions)) < 2:
        return
    turned_s, turning, yaw = _turning(attitudes)
    moved_s = np.array([one.time_s for one in positions])
    velocity = np.array([(p.north_m_s, p.east_m_s, p.down_m_s) for p in positions]).T
    heading = np.asarray(np.interp(moved_s, turned_s, np.unwrap(yaw)), np.float64)
    forward, right = in_heading(velocity[0], velocity[1], heading)
    outputs = ((moved_s, forward), (moved_s, right), (moved_s, velocity[2]), (turned_s, turning))
    for axis, inputs, (seen_s, output) in zip(VehicleAxis, asked, outputs, strict=True):
        # What was asked before the stretch is not known: telemetry from before it is left out.
        first_s, last_s = _busy(times, inputs)
        inside = (seen_s >= first_s) & (seen_s <= last_s)
        if inside.sum() > 2:
            yield axis, ResponseData(name, times, inputs, seen_s[inside], output[inside])


def _busy(times: Array, inputs: Array) -> tuple[float, float]:
    """Return from when until when an axis was busy: what the others did meanwhile is left out."""
    # The first setpoints go on from how the vehicle moved before, which is not known.
    settled = times >= times[0] + _AFTER_S / 2
    if not settled.any():
        return float(times[0]), float(times[0])
    quiet = _QUIET * np.ptp(inputs)
    begun = np.flatnonzero(settled & (np.abs(inputs - inputs[settled][0]) > quiet))
    if not len(begun):
        return float(times[0]), float(times[0])
    last = int(np.flatnonzero(np.abs(inputs - inputs[-1]) > quiet)[-1])
    first_s, last_s = float(times[begun[0]]), float(times[last])
    return max(float(times[0]), first_s - _BEFORE_S), min(float(times[-1]), last_s + _AFTER_S)


def _fresh(found: Iterable[_Telemetry | None]) -> list[_Telemetry]:
    """Return each telemetry once, in the order of time."""
    kept: list[_Telemetry] = []
    for one in found:
        if one is not None and (not kept or one.time_s > kept[-1].time_s):
            kept.append(one)
    return kept


def _turning(attitudes: Sequence[Attitude]) -> tuple[Array, Array, Array]:
    """Return times, the heading's rate and the heading."""
    rows = np.array([(a.time_s, *a.numbers) for a in attitudes], np.float64).T
    times, roll, pitch, yaw, _, pitching, turning = rows
    rate = (pitching * np.sin(roll) + turning * np.cos(roll)) / np.cos(pitch)
    return times, rate, yaw


def _camera_delays(flight: RecordedFlight) -> list[float]:
    """Return from each frame's exposure to the first setpoint sent that was made from it."""
    latency_s = flight.config.number("camera", "latency_s") or 0.0
    return [delay_s + latency_s for delay_s in setpoint_delays(flight.log.controls).values()]


def _sizes(flight: RecordedFlight) -> list[SizeSample]:
    """Return the target's angular size with its range, where the line of sight meets the ground."""
    middle_m = flight.config.number("servo", "target_middle_m")
    if middle_m is None:
        middle_m = ServoSettings().target_middle_m
    heights = _fresh(record.vehicle.position for record in flight.log.controls)
    if len(heights) < 2:
        return []
    height_s = np.array([one.time_s for one in heights])
    height_m = np.array([one.height_m for one in heights])
    found: list[SizeSample] = []
    last_s = -math.inf
    for observation in flight.observations:
        bearing = observation.sighting
        elevation = bearing.line_of_sight.elevation_rad
        usable = observation.verdict in _USED and not bearing.is_cut
        world = bearing.frame is BearingFrame.WORLD and elevation < -_FLATTEST_RAD
        above_m = float(np.interp(bearing.time_s, height_s, height_m)) - middle_m
        if usable and world and above_m > _LOWEST_M and bearing.time_s - last_s >= _APART_S:
            last_s = bearing.time_s
            found.append(SizeSample(math.exp(bearing.log_scale), above_m / math.sin(-elevation)))
    return found


def read_px4_log(path: Path) -> Recording:
    """Read one log; what the link adds to the dead time is not in it.

    Raises:
        TelemetryError: it is no such log, or holds no velocity setpoints.
    """
    samples = read_ulog(path)
    times, asked = _px4_setpoints(path)
    attitudes = np.array(samples.attitudes, np.float64).reshape(-1, 4).T
    positions = np.array(samples.positions, np.float64).reshape(-1, 7).T
    if min(attitudes.shape[1], positions.shape[1]) < 2:
        raise TelemetryError(f"{path}: attitude or local position is missing in it")
    axes: dict[VehicleAxis, list[ResponseData]] = {}
    for number, (start, end) in enumerate(_stretches(times)):
        part = slice(start, end)
        name = f"{path.stem} {number + 1}"
        for axis, record in _px4_axes(name, times[part], asked[:, part], samples):
            if is_excited(record, axis):
                axes.setdefault(axis, []).append(record)
    return Recording(path.stem, axes, is_excitation=True)


def _px4_setpoints(path: Path) -> tuple[Array, Array]:
    """Return times, and north, east, down, yaw rate; where all of them were asked for."""
    pyulog: Any = import_module("pyulog.core")
    with path.open("rb") as file:
        log = pyulog.ULog(file, [_TOPIC])
    data = next((one.data for one in log.data_list if one.multi_id == 0), None)
    names = ("velocity[0]", "velocity[1]", "velocity[2]", "yawspeed")
    if data is None or any(name not in data for name in names):
        raise TelemetryError(f"{path}: no {_TOPIC} with velocities in it: nothing was asked for")
    times = np.asarray(data["timestamp"], np.float64) / 1e6
    asked = np.array([np.asarray(data[name], np.float64) for name in names])
    asked[3] = np.nan_to_num(asked[3])  # NaN is: keep the heading
    known = np.isfinite(asked).all(axis=0) & np.concatenate([[True], np.diff(times) > 0])
    return times[known], asked[:, known]


def _stretches(times: Array) -> Iterator[tuple[int, int]]:
    """Yield from where to where setpoints came without a pause."""
    ends = [*np.flatnonzero(np.diff(times) > _PAUSE_S) + 1, len(times)]
    start = 0
    for end in ends:
        if end - start >= _LEAST_SETPOINTS:
            yield start, int(end)
        start = int(end)


def _px4_axes(
    name: str, times: Array, asked: Array, samples: TelemetrySamples
) -> Iterator[tuple[VehicleAxis, ResponseData]]:
    attitudes = np.array(samples.attitudes, np.float64).T
    positions = np.array(samples.positions, np.float64).T
    gyro = np.array(samples.gyro, np.float64).T if samples.gyro else None
    yaw = np.unwrap(attitudes[3])
    forward, right = in_heading(asked[0], asked[1], np.interp(times, attitudes[0], yaw))
    ahead, across = in_heading(
        positions[4], positions[5], np.interp(positions[0], attitudes[0], yaw)
    )
    rate_s, rate = (
        (attitudes[0], np.gradient(yaw, attitudes[0])) if gyro is None else (gyro[0], gyro[3])
    )
    rows = (
        (forward, positions[0], ahead),
        (right, positions[0], across),
        (asked[2], positions[0], positions[6]),
        (asked[3], rate_s, rate),
    )
    for axis, (inputs, seen_s, output) in zip(VehicleAxis, rows, strict=True):
        inside = (seen_s >= times[0]) & (seen_s <= times[-1])
        inside &= np.concatenate([[True], np.diff(seen_s) > 0])
        if inside.sum() > 2 and not math.isclose(float(times[0]), float(times[-1])):
            yield axis, ResponseData(name, times, inputs, seen_s[inside], output[inside])
