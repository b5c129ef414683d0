"""Telemetry from PX4's own log (.ulg), through pyulog."""

import struct
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from follower.recording.telemetry_logs.samples import TelemetryError, TelemetrySamples
from follower_vision.geometry.camera_model import Vector

_TOPICS = [
    "vehicle_attitude",
    "vehicle_angular_velocity",
    "sensor_combined",
    "vehicle_local_position",
    "vehicle_status",
]
_GYROS = (("vehicle_angular_velocity", "xyz"), ("sensor_combined", "gyro_rad"))
_ARMED = 2
_MODES = {
    0: "MANUAL",
    1: "ALTCTL",
    2: "POSCTL",
    3: "MISSION",
    4: "LOITER",
    5: "RTL",
    14: "OFFBOARD",
    15: "STABILIZED",
    17: "TAKEOFF",
    18: "LAND",
}
"""PX4's nav_state, the ones of a multirotor's everyday (vehicle_status.msg)."""


def read_ulog(path: Path) -> TelemetrySamples:
    """Read a .ulg: attitude, gyro, local position and mode, the first instance of each.

    Raises:
        TelemetryError: it is no such log, lacks a field, or pyulog is not installed.
        OSError: it cannot be read.
    """
    topics = _topics(path)
    try:
        return _samples(topics)
    except KeyError as error:
        raise TelemetryError(
            f"{path}: a topic lacks the field {error}: the log is damaged, or of a version of PX4 "
            f"that is not known here; it has {', '.join(topics)}"
        ) from error


def _samples(topics: Mapping[str, Any]) -> TelemetrySamples:
    samples = TelemetrySamples()
    attitude = topics.get("vehicle_attitude")
    if attitude is not None:
        quaternions = _columns(attitude, [f"q[{n}]" for n in range(4)])
        samples.attitudes = _rows(_time(attitude), _euler(quaternions))
    for name, field in _GYROS:
        if name in topics and not samples.gyro:
            rates = _columns(topics[name], [f"{field}[{n}]" for n in range(3)])
            samples.gyro = _rows(_time(topics[name]), rates)
    place = topics.get("vehicle_local_position")
    if place is not None:
        numbers = _columns(place, ["x", "y", "z", "vx", "vy", "vz"])
        samples.positions = _rows(_time(place), numbers)
    status = topics.get("vehicle_status")
    if status is not None:
        columns = status["timestamp"], status["nav_state"], status["arming_state"]
        for stamp, state, arming in zip(*columns, strict=True):
            mode = _MODES.get(int(state), f"NAV_STATE {int(state)}")
            samples.add_mode(float(stamp) / 1e6, mode, int(arming) == _ARMED)
    return samples


def _topics(path: Path) -> dict[str, Any]:
    """Return the data of each topic's first instance, by its name."""
    try:
        pyulog: Any = import_module("pyulog.core")
    except ImportError as error:
        raise TelemetryError(f"{path}: PX4 logs need the package pyulog: {error}") from error
    broken = (TypeError, ValueError, KeyError, IndexError, AttributeError, struct.error)
    try:
        with path.open("rb") as file:
            log = pyulog.ULog(file, _TOPICS)
    except (*broken, pyulog.ULogException) as error:
        raise TelemetryError(f"{path}: this is no PX4 log ({error})") from error
    return {one.name: one.data for one in log.data_list if one.multi_id == 0}


def _time(data: Any) -> Vector:
    """Return the samples' times in seconds: when they were taken, if the log says it."""
    taken = data.get("timestamp_sample")
    stamps = data["timestamp"] if taken is None or not np.all(taken) else taken
    return np.asarray(stamps, np.float64) / 1e6


def _columns(data: Any, names: list[str]) -> Vector:
    return np.column_stack([np.asarray(data[name], np.float64) for name in names])


def _rows(time_s: Vector, table: Vector) -> list[tuple[float, ...]]:
    return [tuple(row) for row in np.column_stack([time_s, table]).tolist()]


def _euler(q: Vector) -> Vector:
    """Return (roll, pitch, yaw), (N, 3), of quaternions body to world (w, x, y, z), (N, 4)."""
    w, x, y, z = q.T
    return np.column_stack(
        [
            np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
            np.arcsin(np.clip(2 * (w * y - z * x), -1, 1)),
            np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
        ]
    )
