"""MISB ST 0601: what an aircraft writes beside its video, in packets of key, length and value."""

import math
from array import array

import numpy as np

from follower.recording.telemetry_logs.samples import TelemetryError, TelemetrySamples
from follower_vision.geometry.camera_model import Vector

KEY = bytes.fromhex("060e2b34020b01010e01030101000000")
"""The UAS Datalink Local Set's universal label, with which a packet begins."""
_LONGEST = 1 << 16
_SET_S = 10.0
"""A clock that is so far from the others' has not been set yet, or was set again."""
_CHECKSUM = b"\x01\x02"
_STAMP = 2
_HEADING, _PITCH, _ROLL, _FULL_PITCH, _FULL_ROLL = 5, 6, 7, 90, 91
_LATITUDE, _LONGITUDE, _ALTITUDE, _ELLIPSOID_HEIGHT = 13, 14, 15, 75
_FOV, _AZIMUTH, _ELEVATION, _SENSOR_ROLL, _GROUND = 16, 18, 19, 20, 25
_HEIGHTS_M = (-900.0, 19_000.0)
_TAGS: dict[int, tuple[int, float, float]] = {
    _HEADING: (2, 0, 360),
    _PITCH: (2, -20, 20),
    _ROLL: (2, -50, 50),
    _FULL_PITCH: (4, -90, 90),
    _FULL_ROLL: (4, -90, 90),
    _LATITUDE: (4, -90, 90),
    _LONGITUDE: (4, -180, 180),
    _ALTITUDE: (2, *_HEIGHTS_M),
    _ELLIPSOID_HEIGHT: (2, *_HEIGHTS_M),
    _FOV: (2, 0, 180),
    _AZIMUTH: (4, 0, 360),
    _ELEVATION: (4, -180, 180),
    _SENSOR_ROLL: (4, 0, 360),
    _GROUND: (2, *_HEIGHTS_M),
}
"""Bytes, least and largest value of the tags that we read: degrees, metres above the sea.

Where the limits are opposite, the number is signed, and its most negative one means "unknown".
"""
_COLUMNS = [*_TAGS]


def decode(packet: bytes) -> dict[int, float]:
    """Return the values of one packet by their tags; those we do not know are left out.

    Args:
        packet: from its key to its checksum. Tag 2 becomes seconds since 1970.

    Raises:
        TelemetryError: it is cut off, or its checksum does not fit.
    """
    if not packet.startswith(KEY):
        raise TelemetryError("this is no packet of MISB ST 0601: its key is another one")
    length, at = _length(packet, len(KEY))
    if length < 0 or at + length != len(packet):
        raise TelemetryError("a packet of MISB ST 0601 is cut off")
    if packet[-4:-2] != _CHECKSUM or _checksum(packet[:-2]) != int.from_bytes(packet[-2:]):
        raise TelemetryError("a packet of MISB ST 0601 has a wrong checksum")
    values: dict[int, float] = {}
    while at < len(packet):
        tag, at = _tag(packet, at)
        length, at = _length(packet, at)
        if length < 0 or at + length > len(packet):
            raise TelemetryError("a value of MISB ST 0601 is longer than its packet")
        value = _value(tag, packet[at : at + length])
        if value is not None:
            values[tag] = value
        at += length
    return values


def split(data: bytes) -> tuple[list[bytes], bytes]:
    """Cut a stream into packets; return them, and what has to wait for more.

    A packet that another one's key interrupts is returned as far as it goes.
    """
    found: list[bytes] = []
    end, at = 0, data.find(KEY)
    while at >= 0:
        length, body = _length(data, at + len(KEY))
        following = data.find(KEY, at + len(KEY))
        end = body + length
        if length < 0 or length > _LONGEST or end > len(data) or 0 <= following < end:
            if following < 0 and len(data) - at <= _LONGEST:
                return found, data[at:]
            end = following if following >= 0 else len(data)
        found.append(data[at:end])
        at = data.find(KEY, end)
    return found, data[max(end, len(data) - len(KEY) + 1) :]


def _checksum(data: bytes) -> int:
    """Return the 16-bit sum of all pairs of bytes."""
    return (256 * sum(data[::2]) + sum(data[1::2])) & 0xFFFF


def _tag(data: bytes, at: int) -> tuple[int, int]:
    """Return a tag (BER-OID: seven bits a byte, the last one below 128) and where it ends."""
    tag = 0
    while at < len(data):
        tag, at = tag << 7 | data[at] & 0x7F, at + 1
        if data[at - 1] < 0x80:
            break
    return tag, at


def _length(data: bytes, at: int) -> tuple[int, int]:
    """Return a length (BER) and where it ends; -1 for one that is cut off or has no end."""
    if at >= len(data):
        return -1, at
    first, at = data[at], at + 1
    if first < 0x80:
        return first, at
    size = first & 0x7F
    if not 0 < size <= 8 or at + size > len(data):
        return -1, at
    return int.from_bytes(data[at : at + size]), at + size


def _value(tag: int, data: bytes) -> float | None:
    if tag == _STAMP and 0 < len(data) <= 8:
        return int.from_bytes(data) / 1e6
    size, least, most = _TAGS.get(tag, (0, 0.0, 0.0))
    if not size or len(data) != size:
        return None
    if least != -most:
        return least + int.from_bytes(data) * (most - least) / ((1 << 8 * size) - 1)
    number, half = int.from_bytes(data, signed=True), (1 << 8 * size) // 2
    return None if number == -half else number * most / (half - 1)


class KlvReader:
    """Gathers packets of MISB ST 0601 from the pieces of a stream.

    Attributes:
        broken: packets that were left out: cut off, or with a wrong checksum.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._rows = array("d")
        self.broken = 0

    @staticmethod
    def knows(data: bytes) -> bool:
        """Whether a piece is of such a stream."""
        return KEY in data

    def take(self, data: bytes, shown_s: float, _duration_s: float) -> None:
        """Take a piece that belongs to the video's time `shown_s`; NaN if nobody says."""
        packets, self._rest = split(self._rest + data)
        for packet in packets:
            try:
                values = decode(packet)
            except TelemetryError:
                self.broken += 1
                continue
            row = (values.get(tag, math.nan) for tag in (_STAMP, *_COLUMNS))
            self._rows.extend((shown_s, *row))

    def samples(self) -> TelemetrySamples:
        """Return everything: the aircraft's attitude, the sensor's, and where the sensor is.

        The packets' own stamps are brought onto the video's time by the median difference; one of
        a clock that was not set yet does not count. Heights count from the first frame centre's
        elevation, or where there is none from the first one.

        Raises:
            TelemetryError: there was no good packet.
        """
        table: Vector = np.array(self._rows, np.float64).reshape(-1, 2 + len(_COLUMNS))
        if not len(table):
            raise TelemetryError(
                f"no packet of MISB ST 0601 in it is whole ({self.broken} are broken)"
            )
        shown, stamp = table[:, 0], table[:, 1]
        late = (shown - stamp)[np.isfinite(shown - stamp)]
        offset = float(np.median(late)) if len(late) else -float(np.nan_to_num(stamp[0]))
        is_set = np.isfinite(stamp) & ~(np.abs(shown - stamp - offset) > _SET_S)
        time = np.where(is_set, stamp + offset, shown)
        value = dict(zip(_COLUMNS, table[:, 2:].T, strict=True))
        samples = TelemetrySamples(on_video_clock=True)
        roll, pitch = (
            np.where(np.isfinite(value[full]), value[full], value[short])
            for full, short in ((_FULL_ROLL, _ROLL), (_FULL_PITCH, _PITCH))
        )
        samples.attitudes = _rows(time, roll, pitch, value[_HEADING])
        sensor_roll = np.nan_to_num(value[_SENSOR_ROLL])
        samples.gimbals = _rows(time, sensor_roll, value[_ELEVATION], value[_AZIMUTH])
        sea, ellipsoid = value[_ALTITUDE], value[_ELLIPSOID_HEIGHT]
        height = sea if np.isfinite(sea).any() else ellipsoid
        for known in (value[_GROUND], height):
            if np.isfinite(known).any():
                height = height - known[np.isfinite(known)][0]
                break
        fixes = np.column_stack([time, value[_LATITUDE], value[_LONGITUDE], height])
        for row in fixes[np.isfinite(fixes).all(axis=1)].tolist():
            samples.add_fix(*row)
        views = value[_FOV][value[_FOV] > 0]
        samples.fov_deg = float(views[0]) if len(views) else None
        return samples


def _rows(time_s: Vector, *angles_deg: Vector) -> list[tuple[float, ...]]:
    table = np.column_stack([time_s, *np.radians(angles_deg)])
    return [tuple(row) for row in table[np.isfinite(table).all(axis=1)].tolist()]
