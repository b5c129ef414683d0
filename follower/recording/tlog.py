"""`mavlink.tlog`: every MAVLink packet with its time, as Mission Planner and MAVProxy write it.

Each packet follows its time in microseconds since 1970 as eight bytes, big-endian. The two lowest
bits of the time name the link, as MAVProxy has it: 0 is what came from the autopilot, 1 is what we
sent. The time is thereby exact to 4 microseconds.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

from follower.recorder.append_file import AppendFile
from follower_vision.framesource import ClosesItself

SETUP_SIGNING = 256
"""The message that carries a secret key. It is never written."""

_V1, _V2 = 0xFE, 0xFD
_SIGNED = 0x01
_STAMP = struct.Struct(">Q")


class Direction(IntEnum):
    """Which way a packet went."""

    RECEIVED = 0
    SENT = 1


@dataclass(frozen=True, slots=True)
class Packet:
    """One MAVLink packet.

    Attributes:
        time_s: when it was received or sent, on the flight's clock.
        direction: which way it went.
        data: its bytes.
    """

    time_s: float
    direction: Direction
    data: bytes


class PacketSplitter:
    """Cuts a stream of bytes into MAVLink packets; what is none is passed over."""

    def __init__(self) -> None:
        self._rest = b""

    def split(self, data: bytes) -> list[bytes]:
        """Return the packets that are complete now."""
        stream = self._rest + data
        packets: list[bytes] = []
        at = _next_start(stream, 0)
        while (length := _length(stream, at)) and at + length <= len(stream):
            packets.append(stream[at : at + length])
            at = _next_start(stream, at + length)
        self._rest = stream[at:]
        return packets


class TlogWriter(ClosesItself):
    """Writes packets of both directions.

    Raises:
        OSError: the file cannot be made; by `commit`: the disk is full.
    """

    def __init__(self, path: Path, epoch_ns: int) -> None:
        self._file = AppendFile(path)
        self._epoch_us = epoch_ns // 1000
        self._splitters = {direction: PacketSplitter() for direction in Direction}

    def write(self, data: bytes, direction: Direction, time_s: float) -> None:
        """Take bytes as they came from or went to the link; secrets are left out."""
        stamp_us = max(0, self._epoch_us + round(time_s * 1e6)) & ~3 | direction
        for packet in self._splitters[direction].split(data):
            if message_id(packet) != SETUP_SIGNING:
                self._file.write(_STAMP.pack(stamp_us) + packet)

    def commit(self) -> None:
        """Put all packets onto the disk."""
        self._file.commit()

    def close(self) -> None:
        """Commit and close."""
        try:
            self._file.commit()
        finally:
            self._file.close()


def read_tlog(path: Path, epoch_ns: int = 0, remarks: list[str] | None = None) -> Iterator[Packet]:
    """Return the packets of a tlog; bytes that are none, or only a part of one, are passed over.

    Args:
        path: the file.
        epoch_ns: the flight's time 0 in nanoseconds since 1970; times are counted from it.
        remarks: gets a sentence if bytes were passed over.

    Raises:
        OSError: it cannot be read.
    """
    data = path.read_bytes()
    at = passed = 0
    while at < len(data):
        end = _record_end(data, at)
        if not end:
            start, at = at, _next_record(data, at + 1)
            passed += at - start
            continue
        (stamp_us,) = _STAMP.unpack_from(data, at)
        time_s = ((stamp_us & ~3) - epoch_ns // 1000) / 1e6
        direction = Direction.SENT if stamp_us & 3 == Direction.SENT else Direction.RECEIVED
        yield Packet(time_s, direction, data[at + 8 : end])
        at = end
    if passed and remarks is not None:
        remarks.append(f"{passed} bytes of {path.name} are cut off or damaged.")


def message_id(packet: bytes) -> int:
    """Return the message's number."""
    return packet[5] if packet[0] == _V1 else int.from_bytes(packet[7:10], "little")


def _record_end(data: bytes, at: int) -> int:
    """Return where the record that begins at `at` ends, 0 if none does or it is not whole."""
    length = _length(data, at + 8)
    end = at + 8 + length
    return end if length and end <= len(data) else 0


def _next_record(data: bytes, at: int) -> int:
    """Return where the next record begins that looks like one and has another or the end behind."""
    packet = _next_start(data, at + 8)
    while packet < len(data):
        end = _record_end(data, packet - 8)
        # A time since 1970 in microseconds needs seven of its eight bytes for 2000 years to come.
        if end and data[packet - 8] == 0 and (end == len(data) or _length(data, end + 8)):
            return packet - 8
        packet = _next_start(data, packet + 1)
    return len(data)


def _next_start(stream: bytes, at: int) -> int:
    """Return where the next packet may begin, the stream's end if nowhere."""
    starts = [i for i in (stream.find(_V1, at), stream.find(_V2, at)) if i >= 0]
    return min(starts, default=len(stream))


def _length(stream: bytes, at: int) -> int:
    """Return the length of the packet that begins at `at`, 0 if its head is not complete."""
    if len(stream) < at + 3:
        return 0
    payload = stream[at + 1]
    if stream[at] == _V1:
        return 8 + payload
    if stream[at] == _V2:
        return 12 + payload + (13 if stream[at + 2] & _SIGNED else 0)
    return 0
