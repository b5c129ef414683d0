"""GPMF: what GoPro's cameras measure while they film, in a track of the video file."""

import contextlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from follower.recording.telemetry_logs.samples import TelemetryError, TelemetrySamples
from follower_vision.geometry.camera_model import Vector
from follower_vision.geometry.line_of_sight import wrap_angle

DEVICE = b"DEVC"
_HEAD = 8
_DEEPEST = 8
_GYRO, _ACCELERATION, _GPS, _NEW_GPS = b"GYRO", b"ACCL", b"GPS5", b"GPS9"
_COLUMNS = {_GYRO: 3, _ACCELERATION: 3, _GPS: 5, _NEW_GPS: 9}
_MOST = 1e9
"""Nothing measured is as large."""
_TYPES = {
    "b": "i1", "B": "u1", "s": ">i2", "S": ">u2", "l": ">i4", "L": ">u4", "f": ">f4", "d": ">f8",
    "j": ">i8", "J": ">u8",
}  # fmt: skip
_USUAL_AXES = "ZXY"
_MOST_HZ = 100.0
_SETTLE_S = 2.0
"""So slowly the direction of gravity follows the accelerometer, which feels the flight, too."""
_MOVING_M_S = 1.0
_FIX_2D = 2
_GPS9_FIX = 8


@dataclass(frozen=True, slots=True, eq=False)
class Piece:
    """What one payload has of one measured quantity.

    Attributes:
        values: (N, columns), scaled to SI units and degrees.
        axes: which axis each column is of, small letters reversed, as ORIN names them.
        stamp_us: the first sample's time on the camera's clock (STMP), None if it is not told.
        total: samples since the recording began, these included (TSMP); None if it is not told.
        shown_s: the payload's time on the video's clock.
        duration_s: how long it lasts there.
    """

    values: Vector
    axes: str = _USUAL_AXES
    stamp_us: float | None = None
    total: int | None = None
    shown_s: float = 0.0
    duration_s: float = 1.0


def decode(payload: bytes, shown_s: float = 0.0, duration_s: float = 1.0) -> dict[bytes, Piece]:
    """Return what a payload has of GYRO (rad/s), ACCL (m/s²), GPS5 and GPS9, by these names.

    Raises:
        TelemetryError: it is cut off or inconsistent.
    """
    with np.errstate(all="ignore"):
        return {
            key: _piece(key, fields, shown_s, duration_s)
            for stream in _streams(payload, 0)
            for fields in [dict(_elements(stream))]
            for key in _COLUMNS
            if key in fields and _number(fields, b"GPSF", _FIX_2D) >= _FIX_2D
        }


@dataclass(frozen=True, slots=True)
class _Element:
    """A value: its type's letter, bytes of a sample, number of samples, and the bytes."""

    kind: str
    size: int
    repeat: int
    data: bytes


def _piece(key: bytes, fields: dict[bytes, _Element], shown_s: float, duration_s: float) -> Piece:
    stamp, total = _number(fields, b"STMP", -1), int(_number(fields, b"TSMP", -1))
    values = _scaled(fields[key], fields)
    axes = fields[b"ORIN"].data.decode("latin-1") if b"ORIN" in fields else _USUAL_AXES
    if values.shape[1] != _COLUMNS[key] or sorted(axes.upper()) != ["X", "Y", "Z"]:
        raise TelemetryError(f"GPMF's {key.decode()} has {values.shape[1]} columns, axes {axes!r}")
    return Piece(
        values,
        axes,
        None if stamp < 0 else stamp,
        None if total < 0 else total,
        shown_s,
        duration_s,
    )


def _elements(data: bytes) -> Iterator[tuple[bytes, _Element]]:
    """Yield name and value of each element; each is filled up to whole groups of four bytes."""
    at = 0
    while at + _HEAD <= len(data):
        key, kind, size = data[at : at + 4], chr(data[at + 4]), data[at + 5]
        repeat = int.from_bytes(data[at + 6 : at + _HEAD])
        at += _HEAD
        if at + size * repeat > len(data):
            raise TelemetryError(f"GPMF's {key.decode('latin-1')!r} is cut off")
        yield key, _Element(kind, size, repeat, data[at : at + size * repeat])
        at += size * repeat + -size * repeat % 4


def _streams(data: bytes, depth: int) -> Iterator[bytes]:
    """Yield the contents of all streams (STRM), in whichever device they are."""
    for key, element in _elements(data):
        if element.kind == "\0" and depth < _DEEPEST:
            if key == b"STRM":
                yield element.data
            else:
                yield from _streams(element.data, depth + 1)


def _scaled(element: _Element, fields: dict[bytes, _Element]) -> Vector:
    """Return samples divided by SCAL, (N, columns)."""
    values = _table(element, fields.get(b"TYPE"))
    if b"SCAL" not in fields:
        return values
    divisors = _table(fields[b"SCAL"], None).ravel()
    if len(divisors) not in (1, values.shape[1]) or not divisors.all():
        raise TelemetryError("GPMF's SCAL does not fit its values")
    return np.asarray(values / divisors, np.float64)


def _table(element: _Element, layout: _Element | None) -> Vector:
    letters = element.kind
    if letters == "?" and layout is not None:
        letters = layout.data[:255].decode("latin-1").rstrip("\0")
    if not letters or any(letter not in _TYPES for letter in letters):
        raise TelemetryError(f"GPMF has values of type {letters!r}, which is not known here")
    width = sum(np.dtype(_TYPES[letter]).itemsize for letter in letters)
    times = element.size // width if len(letters) == 1 else 1
    if times < 1 or element.size != width * times:
        raise TelemetryError("GPMF's TYPE does not fit its values")
    row = np.dtype([(str(n), _TYPES[letter]) for n, letter in enumerate(letters * times)])
    rows: Any = np.frombuffer(element.data, row)
    table = np.column_stack([rows[name].astype(np.float64) for name in row.names or []])
    return np.asarray(table, np.float64)


def _number(fields: dict[bytes, _Element], key: bytes, missing: float) -> float:
    values = _table(fields[key], None).ravel() if key in fields else np.empty(0)
    number = float(values[0]) if len(values) else missing
    return number if math.isfinite(number) else missing


@dataclass(slots=True)
class GpmfReader:
    """Gathers the payloads of a video's GPMF track; broken ones are left out."""

    _pieces: dict[bytes, list[Piece]] = field(default_factory=dict)

    @staticmethod
    def knows(data: bytes) -> bool:
        """Whether a payload is GPMF."""
        return data.startswith(DEVICE)

    def take(self, data: bytes, shown_s: float, duration_s: float) -> None:
        """Take a payload that belongs to the video's time `shown_s` and lasts `duration_s`."""
        with contextlib.suppress(TelemetryError):
            for key, piece in decode(data, shown_s, duration_s).items():
                self._pieces.setdefault(key, []).append(piece)

    def samples(self) -> TelemetrySamples:
        """Return everything: the place by GPS, the attitude by gyro and accelerometer.

        The camera is taken to look ahead: its heading is the course over ground, on the average.
        Heights count from the first fix.

        Raises:
            TelemetryError: there is neither a fix nor a gyro.
        """
        samples = TelemetrySamples(on_video_clock=True)
        firsts = [pieces[0] for pieces in self._pieces.values()]
        stamped = [(one.stamp_us, one.shown_s) for one in firsts if one.stamp_us is not None]
        stamp_us, shown_s = min(stamped, default=(0.0, 0.0))
        zero_s = shown_s - stamp_us / 1e6
        for key in (_GPS, _NEW_GPS):
            self._take_fixes(samples, key, zero_s)
        gyro = self._turned(_GYRO, zero_s)
        force = self._turned(_ACCELERATION, zero_s)
        if len(gyro) > 1 and len(force) > 1:
            samples.gyro = [tuple(row) for row in gyro.tolist()]
            attitudes = _attitudes(gyro, force)
            attitudes[:, 3] += _north(attitudes, samples)
            samples.attitudes = [tuple(row) for row in attitudes.tolist()]
        if not samples.attitudes and not samples.places:
            raise TelemetryError(
                "GPMF without a GPS fix, and without gyro and accelerometer: nothing to import"
            )
        return samples

    def _take_fixes(self, samples: TelemetrySamples, key: bytes, zero_s: float) -> None:
        rows = self._timed(key, zero_s)
        if key == _NEW_GPS:
            rows = rows[rows[:, _GPS9_FIX + 1] >= _FIX_2D]
        for time_s, latitude, longitude, height_m in rows[:, :4].tolist():
            samples.add_fix(time_s, latitude, longitude, height_m - rows[0, 3])

    def _timed(self, key: bytes, zero_s: float) -> Vector:
        """Return rows (time, values), (N, 1 + columns)."""
        pieces = [piece for piece in self._pieces.get(key, ()) if len(piece.values)]
        if not pieces:
            return np.empty((0, 1 + _COLUMNS[key]))
        values = np.concatenate([piece.values for piece in pieces])
        rows = np.column_stack([_times(pieces, zero_s), values])
        return np.asarray(rows[(np.abs(rows) < _MOST).all(axis=1)], np.float64)

    def _turned(self, key: bytes, zero_s: float) -> Vector:
        """Return rows (time, forward, right, down), at most 100 a second.

        GoPro's axes: X to the left, Y back, Z up; ORIN says in which order they come.
        """
        rows = self._timed(key, zero_s)
        if not len(rows):
            return rows
        axes = self._pieces[key][0].axes
        sign = {axis.upper(): 1 if axis.isupper() else -1 for axis in axes}
        columns = [1 + axes.upper().index(axis) for axis in "YXZ"]
        values = -rows[:, columns] * [sign[axis] for axis in "YXZ"]
        rows = np.column_stack([rows[:, 0], values])
        rate_hz = (len(rows) - 1) / max(rows[-1, 0] - rows[0, 0], 1e-6)
        group = max(1, math.ceil(rate_hz / _MOST_HZ))
        whole = len(rows) // group * group
        return np.asarray(rows[:whole].reshape(-1, group, 4).mean(axis=1), np.float64)


def _times(pieces: list[Piece], zero_s: float) -> Vector:
    """Return when each sample was taken, on the video's time; `zero_s` is where STMP is 0 there.

    A payload's first sample is told by STMP, else by the video's time; TSMP counts those between.
    """
    starts = [
        piece.shown_s if piece.stamp_us is None else zero_s + piece.stamp_us / 1e6
        for piece in pieces
    ]
    times = []
    step_s = pieces[0].duration_s / len(pieces[0].values)
    for n, piece in enumerate(pieces):
        count = len(piece.values)
        if n + 1 < len(pieces):
            until = pieces[n + 1]
            between = count
            if piece.total is not None and until.total is not None:
                between = until.total - len(until.values) - (piece.total - count)
            step_s = (starts[n + 1] - starts[n]) / max(between, count)
        times.append(starts[n] + step_s * np.arange(count))
    return np.concatenate(times)


def _attitudes(gyro: Vector, force: Vector) -> Vector:
    """Return rows (time, roll, pitch, yaw) by a complementary filter; yaw counts from 0.

    Args:
        gyro: rows (time, rates about forward, right, down in rad/s).
        force: rows (time, specific force along them in m/s²).
    """
    pulls = np.column_stack([np.interp(gyro[:, 0], force[:, 0], one) for one in force[:, 1:].T])
    sizes = np.linalg.norm(pulls, axis=1, keepdims=True)
    downs = (-pulls / np.maximum(sizes, 1e-6)).tolist()
    x, y, z = downs[0]
    yaw, before_s, rows = 0.0, float(gyro[0, 0]), []
    for (time_s, p, q, r), (ax, ay, az) in zip(gyro.tolist(), downs, strict=True):
        dt, before_s = max(time_s - before_s, 0.0), time_s
        gain = min(dt / _SETTLE_S, 1.0)
        x, y, z = (
            x + dt * (y * r - z * q) + gain * (ax - x),
            y + dt * (z * p - x * r) + gain * (ay - y),
            z + dt * (x * q - y * p) + gain * (az - z),
        )
        size = max(math.sqrt(x * x + y * y + z * z), 1e-6)
        x, y, z = x / size, y / size, z / size
        level = max(math.hypot(y, z), 0.05)
        yaw += dt * (q * y + r * z) / (level * level)
        rows.append((time_s, math.atan2(y, z), math.asin(min(max(-x, -1.0), 1.0)), yaw))
    return np.array(rows, np.float64)


def _north(attitudes: Vector, samples: TelemetrySamples) -> float:
    """Return what turns the yaw so that it is the course over ground; 0 without a way."""
    moved = samples.velocities()
    time, north, east = moved[:, 0], moved[:, 4], moved[:, 5]
    fast = np.hypot(north, east) > _MOVING_M_S
    if not fast.any():
        return 0.0
    yaw = np.interp(time[fast], attitudes[:, 0], attitudes[:, 3])
    course = np.arctan2(east[fast], north[fast])
    turn = np.sum(np.hypot(north[fast], east[fast]) * np.exp(1j * (course - yaw)))
    return wrap_angle(float(np.angle(turn)))
