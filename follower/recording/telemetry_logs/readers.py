"""Readers of telemetry logs: MAVLink's tlog, ArduPilot's .bin, PX4's .ulg, and CSV."""

import csv
import io
import math
import os
import struct
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink import DFReader
from pymavlink.dialects.v20 import common as mavlink

from follower.links.vehicle_finder import NO_VEHICLES
from follower.links.vehicle_monitor import mode_name
from follower.recording.telemetry_logs.samples import TelemetryError, TelemetrySamples
from follower.recording.tlog import read_tlog
from follower_vision.geometry.camera_model import Vector
from follower_vision.geometry.line_of_sight import roll_pitch_yaw

_REBOOT_S = 1.0


def read_mavlink(path: Path) -> TelemetrySamples:
    """Read a tlog, the messages of the first autopilot that is heard in it.

    Attitudes and positions carry the autopilot's own time since boot, which is free of the link's
    delays; it is brought onto the log's time by the smallest delay.

    Raises:
        TelemetryError: there is not one MAVLink message in it.
        OSError: it cannot be read.
    """
    samples, clock, heard = TelemetrySamples(), _BootClock(), None
    for arrival_s, message in _messages(path):
        kind = message.get_type()
        sender = message.get_srcSystem(), message.get_srcComponent()
        if kind == "HEARTBEAT" and _is_autopilots(message):
            heard = heard or sender
        if sender != heard:
            continue  # companions and gimbals have the vehicle's system, and modes of their own
        if kind == "ATTITUDE":
            clock.take(message, arrival_s, samples.attitudes)
            samples.attitude_rates.append((message.rollspeed, message.pitchspeed, message.yawspeed))
            samples.attitudes.append((0.0, message.roll, message.pitch, message.yaw))
        elif kind == "LOCAL_POSITION_NED":
            clock.take(message, arrival_s, samples.positions)
            m = message
            samples.positions.append((0.0, m.x, m.y, m.z, m.vx, m.vy, m.vz))
        elif kind == "HEARTBEAT":
            armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            mode = mode_name(message.autopilot, message.custom_mode)
            samples.add_mode(arrival_s, mode, armed)
    clock.settle()
    return samples


def _is_autopilots(beat: Any) -> bool:
    return beat.autopilot != mavlink.MAV_AUTOPILOT_INVALID and beat.type not in NO_VEHICLES


class _BootClock:
    """Brings times since boot onto the log's time, once all are known.

    Each stretch between two boots has an offset of its own: the smallest (arrival - boot).
    """

    def __init__(self) -> None:
        self._offsets: list[float] = []
        self._boot_s = 0.0
        self._stamps: list[tuple[list[tuple[float, ...]], int, float, int]] = []

    def take(self, message: Any, arrival_s: float, rows: list[tuple[float, ...]]) -> None:
        """Remember that the next row to be added belongs to this message."""
        boot_s = message.time_boot_ms / 1000
        if not self._offsets or boot_s < self._boot_s - _REBOOT_S:
            self._offsets.append(arrival_s - boot_s)
        self._offsets[-1] = min(self._offsets[-1], arrival_s - boot_s)
        self._boot_s = boot_s
        self._stamps.append((rows, len(rows), boot_s, len(self._offsets) - 1))

    def settle(self) -> None:
        """Write the times into the rows."""
        for rows, index, boot_s, number in self._stamps:
            rows[index] = (boot_s + self._offsets[number], *rows[index][1:])


def _messages(path: Path) -> Iterator[tuple[float, Any]]:
    codec = mavlink.MAVLink(None)
    codec.robust_parsing = True
    count, first_s = 0, 0.0
    for packet in read_tlog(path):
        for message in codec.parse_buffer(packet.data) or []:
            # Times since 1970 would leave fewer digits for what comes behind the point.
            first_s = first_s if count else packet.time_s
            count += 1
            yield packet.time_s - first_s, message
    if not count:
        raise TelemetryError(f"{path}: there is no MAVLink message in it: this is no tlog")


_ARDUPILOT = 3
_BEGINNING = b"\xa3\x95\x80"
_PADDING = 528
"""Fewer bytes than these after the last message are no damage: a card is written in blocks."""
_KINDS = ["ATT", "IMU", "RATE", "XKF1", "NKF1", "MODE", "ARM"]


def read_dataflash(path: Path) -> TelemetrySamples:
    """Read a .bin: attitude (ATT), gyro (IMU, else RATE), position (XKF1, NKF1), mode (MODE, ARM).

    Raises:
        TelemetryError: it is no such log.
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        # pymavlink searches megabytes of anything for a beginning, and leaves the file open.
        if file.read(len(_BEGINNING)) != _BEGINNING:
            raise TelemetryError(f"{path}: this is no ArduPilot log: it begins otherwise")
    with _silent():
        return _dataflash_samples(path)


@contextmanager
def _silent() -> Iterator[None]:
    """Keep the terminal free of pymavlink's lines, one for each damaged byte, from C and Python."""
    with Path(os.devnull).open("w") as nothing, ExitStack() as undo:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
        terminal = os.dup(2)
        undo.callback(os.close, terminal)
        undo.callback(os.dup2, terminal, 2)
        os.dup2(nothing.fileno(), 2)
        with redirect_stdout(nothing), redirect_stderr(nothing):
            yield


def _dataflash_samples(path: Path) -> TelemetrySamples:
    try:
        log: Any = DFReader.DFReader_binary(str(path))
    except (ValueError, IndexError, KeyError, struct.error) as error:
        raise TelemetryError(f"{path}: this is no ArduPilot log ({error})") from error
    except Exception as error:
        if type(error) is not Exception:
            raise
        # pymavlink's own complaint about a format that it does not know has no class of its own.
        raise TelemetryError(f"{path}: {error}: damaged, or newer than known here") from error
    samples = TelemetrySamples(problem=_damage(log))
    try:
        _read(log, samples)
    except (AttributeError, IndexError, TypeError, ValueError, struct.error) as error:
        wrong = "lacks" if isinstance(error, AttributeError) else "cannot be read:"
        raise TelemetryError(
            f"{path}: a message {wrong} {error}: the log is damaged, or of a version of ArduPilot "
            f"that is not known here; {len(samples.attitudes)} attitudes before it could be read"
        ) from error
    finally:
        log.close()
    return samples


def _damage(log: Any) -> str | None:
    """Return in a sentence how much of a log is no message, None if nothing is."""
    lengths = {kind: form.len for kind, form in log.formats.items() if log.counts[kind]}
    read = sum(log.counts[kind] * length for kind, length in lengths.items())
    end = max((log.offsets[kind][-1] + size for kind, size in lengths.items()), default=0)
    if end == read and log.data_len - end < _PADDING:
        return None
    return f"damaged: {log.data_len - read} of its {log.data_len} bytes are no messages"


def _read(log: Any, samples: TelemetrySamples) -> None:
    """Take all messages; of the gyro itself, or of the rates if there is none."""
    rates, armed = list[tuple[float, ...]](), False
    while (message := log.recv_match(type=_KINDS)) is not None:
        kind = message.get_type()
        armed = bool(message.ArmState) if kind == "ARM" else armed
        _take_message(samples, rates, message, armed)
    if not samples.gyro:
        samples.gyro = rates


def _take_message(
    samples: TelemetrySamples, rates: list[tuple[float, ...]], message: Any, armed: bool
) -> None:
    time_s = message.TimeUS / 1e6
    m = message
    match message.get_type():
        case "ATT":
            angles = (math.radians(angle) for angle in (m.Roll, m.Pitch, m.Yaw))
            samples.attitudes.append((time_s, *angles))
        case "IMU" if getattr(m, "I", 0) == 0:
            samples.gyro.append((time_s, *map(float, (m.GyrX, m.GyrY, m.GyrZ))))
        case "RATE":
            rates.append((time_s, *(math.radians(rate) for rate in (m.R, m.P, m.Y))))
        case "XKF1" | "NKF1" if getattr(m, "C", 0) == 0:
            place = m.PN, m.PE, m.PD, m.VN, m.VE, m.VD
            samples.positions.append((time_s, *map(float, place)))
        case "MODE":
            samples.add_mode(time_s, mode_name(_ARDUPILOT, m.ModeNum), armed)


_TOPICS = [
    "vehicle_attitude",
    "vehicle_angular_velocity",
    "sensor_combined",
    "vehicle_local_position",
    "vehicle_status",
]
_GYROS = (("vehicle_angular_velocity", "xyz"), ("sensor_combined", "gyro_rad"))
_ARMED = 2
_MOST_BACKWARDS = 1000
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
        turns = _columns(attitude, [f"q[{n}]" for n in range(4)])
        rows = _rows(_time(attitude), turns)
        samples.attitudes = [(time_s, *roll_pitch_yaw(*turn)) for time_s, *turn in rows]
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
    broken = (TypeError, ValueError, KeyError, IndexError, AttributeError, EOFError, struct.error)
    try:
        with _ForwardFile(io.FileIO(path)) as file:
            log = pyulog.ULog(file, _TOPICS)
    except (*broken, pyulog.ULogException) as error:
        raise TelemetryError(f"{path}: this is no PX4 log ({error})") from error
    return {one.name: one.data for one in log.data_list if one.multi_id == 0}


class _ForwardFile(io.BufferedReader):
    """A file in which nobody goes back for ever, as pyulog does where a damaged end is too short.

    Raises:
        EOFError: by `seek`, if it is of no use any more; no error of what is read.
    """

    _furthest = _backwards = 0

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """Go to a place and return it."""
        place = super().seek(offset, whence)
        self._backwards = 0 if place > self._furthest else self._backwards + 1
        self._furthest = max(self._furthest, place)
        if self._backwards > _MOST_BACKWARDS:
            raise EOFError("it is cut off or damaged before its first sample")
        return place


def _time(data: Any) -> Vector:
    """Return the samples' times in seconds: when they were taken, if the log says it."""
    taken = data.get("timestamp_sample")
    stamps = data["timestamp"] if taken is None or not np.all(taken) else taken
    return np.asarray(stamps, np.float64) / 1e6


def _columns(data: Any, names: list[str]) -> Vector:
    return np.column_stack([np.asarray(data[name], np.float64) for name in names])


def _rows(time_s: Vector, table: Vector) -> list[tuple[float, ...]]:
    return [tuple(row) for row in np.column_stack([time_s, table]).tolist()]


TIME = "time_s"
ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")
RATES = ("roll_rate_deg_s", "pitch_rate_deg_s", "yaw_rate_deg_s")
PLACE = ("north_m", "east_m", "down_m", "north_m_s", "east_m_s", "down_m_s")
MODE = "mode"


def read_csv(path: Path) -> TelemetrySamples:
    """Read a table with a head.

    Columns: time_s, roll_deg, pitch_deg, yaw_deg; if there are: roll_rate_deg_s, pitch_rate_deg_s,
    yaw_rate_deg_s (of the body, from the gyro); north_m, east_m, down_m, north_m_s, east_m_s,
    down_m_s; mode. Others are passed over. An empty cell says nothing.

    Raises:
        TelemetryError: a column is missing, or a cell is no number.
    """
    samples = TelemetrySamples()
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            has_rates = _check_columns(path, reader.fieldnames or ())
            for number, row in enumerate(reader, 2):
                _take_row(samples, row, has_rates, f"{path}, line {number}")
    except (UnicodeDecodeError, csv.Error) as error:
        raise TelemetryError(f"{path}: this is no table of text ({error})") from error
    return samples


def _check_columns(path: Path, columns: Sequence[str]) -> bool:
    missing = [name for name in (TIME, *ANGLES) if name not in columns]
    if missing:
        raise TelemetryError(
            f"{path}: the column {missing[0]} is missing; needed are "
            f"{', '.join((TIME, *ANGLES))}, and there are {', '.join(columns) or 'none'}"
        )
    return all(name in columns for name in RATES)


def _take_row(
    samples: TelemetrySamples, row: Mapping[str, str | None], has_rates: bool, place: str
) -> None:
    time_s = _number(row, TIME, place)
    angles = [math.radians(_number(row, name, place)) for name in ANGLES]
    if math.isfinite(sum(angles)):
        samples.attitudes.append((time_s, *angles))
        if has_rates:
            rates = tuple(math.radians(_number(row, name, place)) for name in RATES)
            samples.attitude_rates.append(rates)
    if all(row.get(name) for name in PLACE):
        samples.positions.append((time_s, *(_number(row, name, place) for name in PLACE)))
    mode = (row.get(MODE) or "").strip()
    if mode:
        samples.add_mode(time_s, mode, True)


def _number(row: Mapping[str, str | None], name: str, place: str) -> float:
    text = (row.get(name) or "").strip()
    try:
        return float(text) if text else math.nan
    except ValueError:
        raise TelemetryError(f"{place}: {name} is no number, but {text[:40]!r}") from None
