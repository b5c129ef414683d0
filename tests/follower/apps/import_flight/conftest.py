"""One scripted flight, written as every kind of telemetry log."""

from __future__ import annotations

import csv
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from follower_sim.kinematics import BodyState

ATTITUDE_HZ, POSITION_HZ, SECONDS = 50.0, 10.0, 20.0
LOG_BEGINS_S = 3.0
"""The log's first attitude is this much earlier than the video's first frame."""


@dataclass(frozen=True)
class Script:
    """A flight as a formula: where the body is at any time, and how it turns.

    `swing` scales the turns; 0 is a hover.
    """

    swing: float = 1.0

    def angles(self, time_s: float) -> tuple[float, float, float]:
        t, k = time_s, self.swing
        yaw = k * (0.35 * math.sin(0.9 * t) + 0.12 * math.sin(2.3 * t + 1) + 0.02 * t)
        pitch = k * (0.06 * math.sin(1.7 * t + 0.4) + 0.04 * math.sin(0.6 * t))
        roll = k * (0.08 * math.sin(1.1 * t + 2) + 0.03 * math.sin(3.1 * t))
        return roll, pitch, yaw

    def rates(self, time_s: float) -> tuple[float, float, float]:
        step = 1e-4
        before, after = (np.array(self.angles(time_s + s)) for s in (-step, step))
        roll_rate, pitch_rate, yaw_rate = (after - before) / (2 * step)
        roll, pitch, _ = self.angles(time_s)
        return (
            roll_rate - yaw_rate * math.sin(pitch),
            pitch_rate * math.cos(roll) + yaw_rate * math.sin(roll) * math.cos(pitch),
            yaw_rate * math.cos(roll) * math.cos(pitch) - pitch_rate * math.sin(roll),
        )

    def position(self, time_s: float) -> tuple[float, float, float]:
        return 0.4 * self.swing * time_s - 2.0, 0.3 * self.swing * math.sin(time_s), -8.0

    def velocity(self, time_s: float) -> tuple[float, float, float]:
        return 0.4 * self.swing, 0.3 * self.swing * math.cos(time_s), 0.0

    def body(self, time_s: float) -> BodyState:
        return BodyState(
            time_s,
            self.position(time_s),
            self.velocity(time_s),
            self.angles(time_s),
            self.rates(time_s),
        )


def times(rate_hz: float) -> list[float]:
    """When the log has samples, on the script's clock, which is the video's."""
    return [n / rate_hz - LOG_BEGINS_S for n in range(round(SECONDS * rate_hz))]


WriteLog = Callable[[Path, Script], Path]


def write_csv(path: Path, script: Script) -> Path:
    angles = ("roll_deg", "pitch_deg", "yaw_deg")
    rates = tuple(name.replace("_deg", "_rate_deg_s") for name in angles)
    place = ("north_m", "east_m", "down_m", "north_m_s", "east_m_s", "down_m_s")
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("time_s", *angles, *rates, *place, "mode", "comment"))
        for t in times(ATTITUDE_HZ):
            numbers = [math.degrees(v) for v in (*script.angles(t), *script.rates(t))]
            writer.writerow(
                (100 + t, *numbers, *script.position(t), *script.velocity(t), "LOITER", "")
            )
    return path


def write_tlog(
    path: Path, script: Script, boot_s: float = 50.0, delay_s: float = 0.004, component: int = 1
) -> Path:
    """Each packet arrives `delay_s` late and up to 30 ms more; boot times are exact."""
    codec = mavlink.MAVLink(None, 1, component)
    late = np.random.default_rng(4)
    packets: list[tuple[float, bytes]] = []

    def add(t: float, message: object) -> None:
        arrival = t + delay_s + late.exponential(0.005)
        packets.append((arrival, message.pack(codec)))  # type: ignore[attr-defined]

    add(times(1)[0] - 0.5, mavlink.MAVLink_heartbeat_message(2, 12, 0x80 | 1, 6 << 16, 4, 3))
    for t in times(ATTITUDE_HZ):
        boot = round(1000 * (t + boot_s))
        add(t, mavlink.MAVLink_attitude_message(boot, *script.angles(t), *script.rates(t)))
    for t in times(POSITION_HZ):
        boot = round(1000 * (t + boot_s))
        place = (*script.position(t), *script.velocity(t))
        add(t, mavlink.MAVLink_local_position_ned_message(boot, *place))
    epoch_us = 1_790_000_000_000_000
    with path.open("wb") as file:
        for arrival, packet in sorted(packets):
            file.write(struct.pack(">Q", epoch_us + round(1e6 * arrival)) + packet)
    return path


_BIN_MESSAGES = {
    "ATT": (130, "Qccccc", "TimeUS,DesRoll,Roll,DesPitch,Pitch,Yaw"),
    "IMU": (131, "QBfff", "TimeUS,I,GyrX,GyrY,GyrZ"),
    "XKF1": (132, "QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD"),
    "MODE": (133, "QMBB", "TimeUS,Mode,ModeNum,Rsn"),
    "ARM": (134, "QBB", "TimeUS,ArmState,ArmChecks"),
}
_BIN_CODES = {"Q": "Q", "c": "h", "B": "B", "f": "f", "M": "B"}


def write_bin(path: Path, script: Script) -> Path:
    """ArduPilot's format: each kind is described by an FMT message, all begin with A3 95."""
    out = [_fmt(128, 89, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")]
    for name, (number, letters, columns) in _BIN_MESSAGES.items():
        out.append(_fmt(number, 3 + _bin_struct(letters).size, name, letters, columns))

    def add(name: str, t: float, *values: float) -> None:
        number, letters, _ = _BIN_MESSAGES[name]
        head = struct.pack("<BBB", 0xA3, 0x95, number)
        out.append(head + _bin_struct(letters).pack(round(1e6 * (t + 200)), *values))

    add("ARM", times(1)[0], 1, 0)
    add("MODE", times(1)[0], 4, 4, 1)
    for n, t in enumerate(times(ATTITUDE_HZ)):
        roll, pitch, yaw = (round(100 * math.degrees(v)) for v in script.angles(t))
        add("ATT", t, 0, roll, 0, pitch, yaw)
        add("IMU", t, 0, *script.rates(t))
        add("IMU", t, 1, 9.0, 9.0, 9.0)
        if n % 5 == 0:
            add("XKF1", t, 0, *script.velocity(t), *script.position(t))
            add("XKF1", t, 1, *(99.0,) * 6)
    path.write_bytes(b"".join(out))
    return path


def _bin_struct(letters: str) -> struct.Struct:
    return struct.Struct("<" + "".join(_BIN_CODES[letter] for letter in letters))


def _fmt(number: int, length: int, name: str, letters: str, columns: str) -> bytes:
    texts = (name.encode(), letters.encode(), columns.encode())
    return struct.pack("<BBBBB4s16s64s", 0xA3, 0x95, 128, number, length, *texts)


_ULOG_FORMATS = {
    "vehicle_attitude": "uint64_t timestamp;float[4] q;",
    "vehicle_angular_velocity": "uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;",
    "vehicle_local_position": "uint64_t timestamp;float x;float y;float z;"
    "float vx;float vy;float vz;",
    "vehicle_status": "uint64_t timestamp;uint8_t nav_state;uint8_t arming_state;",
}


def write_ulog(path: Path, script: Script) -> Path:
    """PX4's format: formats ('F'), subscriptions ('A'), data ('D'), each with its size."""
    out = [b"\x55\x4c\x6f\x67\x01\x12\x35\x01" + struct.pack("<Q", 1000)]
    out.append(_ulog_message("B", bytes(40)))
    for name, fields in _ULOG_FORMATS.items():
        out.append(_ulog_message("F", f"{name}:{fields}".encode()))
    names = list(_ULOG_FORMATS)
    for number, name in enumerate(names):
        out.append(_ulog_message("A", struct.pack("<BH", 0, number) + name.encode()))

    def add(name: str, layout: str, *values: float) -> None:
        data = struct.pack("<H" + layout, names.index(name), *values)
        out.append(_ulog_message("D", data))

    add("vehicle_status", "QBB", _us(times(1)[0]), 14, 2)
    for n, t in enumerate(times(ATTITUDE_HZ)):
        add("vehicle_attitude", "Q4f", _us(t), *quaternion(*script.angles(t)))
        # What was sampled at t was published 2 ms later.
        add("vehicle_angular_velocity", "QQ3f", _us(t + 0.002), _us(t), *script.rates(t))
        if n % 5 == 0:
            place = (*script.position(t), *script.velocity(t))
            add("vehicle_local_position", "Q6f", _us(t), *place)
    path.write_bytes(b"".join(out))
    return path


def _us(time_s: float) -> int:
    return round(1e6 * (time_s + 300))


def _ulog_message(kind: str, data: bytes) -> bytes:
    return struct.pack("<HB", len(data), ord(kind)) + data


def quaternion(roll: float, pitch: float, yaw: float) -> Sequence[float]:
    (cr, sr), (cp, sp), (cy, sy) = ((math.cos(a / 2), math.sin(a / 2)) for a in (roll, pitch, yaw))
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


WRITERS: dict[str, WriteLog] = {
    "csv": write_csv,
    "tlog": write_tlog,
    "bin": write_bin,
    "ulg": write_ulog,
}


@pytest.fixture(scope="session")
def script() -> Script:
    return Script()


@pytest.fixture(scope="session")
def hover() -> Script:
    return Script(swing=0.0)


@pytest.fixture(scope="session")
def writers() -> dict[str, WriteLog]:
    """Return what writes a script as a log, by the file's ending."""
    return WRITERS
