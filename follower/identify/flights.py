"""Reads a flight's folder: what was sent to the autopilot, and what telemetry said came of it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby, pairwise
from pathlib import Path
from typing import TypeVar

import numpy as np

from follower.excite.pattern import RUN_KEY
from follower.flightlog import ControlRecord
from follower.identify.recording import (
    Recording,
    SizeSample,
    VehicleAxis,
    in_heading,
    is_excited,
)
from follower.recorder import RecordedFlight, open_flight
from follower_control.estimator import Verdict
from follower_control.servo_settings import ServoSettings
from follower_control.sighting import SightFrame
from follower_control.tuning.rational import Array
from follower_control.tuning.response_data import ResponseData
from follower_control.vehicle import Attitude, LocalPosition

_Told = TypeVar("_Told", Attitude, LocalPosition)

_USED = (Verdict.STARTED, Verdict.FUSED, Verdict.RESTARTED)
_LEAST_STEPS = 150
_FLATTEST_RAD = math.radians(8)
_LOWEST_M = 1.5
_APART_S = 0.5
_BEFORE_S, _AFTER_S, _QUIET = 2.0, 4.0, 0.005


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
        for axis, record in _axes(f"{folder.name} {number + 1}", stretch):
            if is_excited(record, axis):
                axes.setdefault(axis, []).append(record)
    remarks = list(flight.remarks)
    if not stretches:
        remarks.append(
            f"{folder}: at no time did the vehicle fly by our setpoints for "
            f"{_LEAST_STEPS} steps on end: nothing of its answers can be told"
        )
    return Recording(
        folder.name,
        axes,
        _camera_delays(flight),
        _intervals(sorted({frame.captured_s for frame in flight.frames})),
        [r.vehicle.attitude_age_s(r.time_s) for r in controls if r.vehicle.attitude is not None],
        [r.vehicle.position_age_s(r.time_s) for r in controls if r.vehicle.position is not None],
        _sizes(flight),
        tuple(remarks),
        RUN_KEY in flight.config.run,
    )


def _flown(controls: Iterable[ControlRecord]) -> Iterator[list[ControlRecord]]:
    """Yield the stretches in which the vehicle flew by our setpoints."""

    def ours(record: ControlRecord) -> bool:
        return record.sent and record.state.engaged and record.vehicle.obeys_setpoints

    for flown, group in groupby(controls, ours):
        if flown:
            yield list(group)


def _axes(
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
    settled = times[1:] > times[0] + _AFTER_S / 2
    changes = np.flatnonzero(settled & (np.abs(np.diff(inputs)) > _QUIET * np.ptp(inputs)))
    if not len(changes):
        return float(times[0]), float(times[0])
    first_s, last_s = float(times[changes[0]]), float(times[changes[-1] + 1])
    return max(float(times[0]), first_s - _BEFORE_S), min(float(times[-1]), last_s + _AFTER_S)


def _fresh(found: Iterable[_Told | None]) -> list[_Told]:
    """Return each telemetry once, in the order of time."""
    kept: list[_Told] = []
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
    uses: dict[float, float] = {}
    for record in flight.log.controls:
        if record.track_captured_s is not None:
            uses.setdefault(record.track_captured_s, record.time_s)
    return [used_s - captured_s + latency_s for captured_s, used_s in uses.items()]


def _intervals(times: Sequence[float]) -> list[float]:
    return [b - a for a, b in pairwise(times)]


def _sizes(flight: RecordedFlight) -> list[SizeSample]:
    """Return how large the target looked from where the line of sight meets level ground."""
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
        sighting = observation.sighting
        elevation = sighting.line_of_sight.elevation_rad
        usable = observation.verdict in _USED and not sighting.is_cut
        world = sighting.frame is SightFrame.WORLD and elevation < -_FLATTEST_RAD
        above_m = float(np.interp(sighting.time_s, height_s, height_m)) - middle_m
        if usable and world and above_m > _LOWEST_M and sighting.time_s - last_s >= _APART_S:
            last_s = sighting.time_s
            found.append(SizeSample(math.exp(sighting.log_scale), above_m / math.sin(-elevation)))
    return found
