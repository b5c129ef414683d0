"""Reads PX4's own log (.ulg): the velocities its controller was given, and what came of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from follower.identify.recording import Recording, VehicleAxis, in_heading, is_excited
from follower.telemetry.log import Samples, TelemetryError
from follower.telemetry.ulog import read_ulog
from follower_control.tuning.rational import Array
from follower_control.tuning.response_data import ResponseData

_TOPIC = "trajectory_setpoint"
_PAUSE_S = 0.5
_LEAST_SETPOINTS = 60


def read_px4_log(path: Path) -> Recording:
    """Read one log; what the link adds to the dead time is not in it.

    Raises:
        TelemetryError: it is no such log, or holds no velocity setpoints.
    """
    samples = read_ulog(path)
    times, asked = _setpoints(path)
    attitudes = np.array(samples.attitudes, np.float64).reshape(-1, 4).T
    positions = np.array(samples.positions, np.float64).reshape(-1, 7).T
    if min(attitudes.shape[1], positions.shape[1]) < 2:
        raise TelemetryError(f"{path}: attitude or local position is missing in it")
    axes: dict[VehicleAxis, list[ResponseData]] = {}
    for number, (start, end) in enumerate(_stretches(times)):
        part = slice(start, end)
        name = f"{path.stem} {number + 1}"
        for axis, record in _axes(name, times[part], asked[:, part], samples):
            if is_excited(record, axis):
                axes.setdefault(axis, []).append(record)
    return Recording(path.stem, axes, is_excitation=True)


def _setpoints(path: Path) -> tuple[Array, Array]:
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


def _axes(
    name: str, times: Array, asked: Array, samples: Samples
) -> Iterator[tuple[VehicleAxis, ResponseData]]:
    turned = np.array(samples.attitudes, np.float64).T
    moved = np.array(samples.positions, np.float64).T
    spun = np.array(samples.gyro, np.float64).T if samples.gyro else None
    yaw = np.unwrap(turned[3])
    forward, right = in_heading(asked[0], asked[1], np.interp(times, turned[0], yaw))
    ahead, across = in_heading(moved[4], moved[5], np.interp(moved[0], turned[0], yaw))
    rate_s, rate = (turned[0], np.gradient(yaw, turned[0])) if spun is None else (spun[0], spun[3])
    rows = (
        (forward, moved[0], ahead),
        (right, moved[0], across),
        (asked[2], moved[0], moved[6]),
        (asked[3], rate_s, rate),
    )
    for axis, (inputs, seen_s, output) in zip(VehicleAxis, rows, strict=True):
        inside = (seen_s >= times[0]) & (seen_s <= times[-1])
        inside &= np.concatenate([[True], np.diff(seen_s) > 0])
        if inside.sum() > 2 and not math.isclose(float(times[0]), float(times[-1])):
            yield axis, ResponseData(name, times, inputs, seen_s[inside], output[inside])
