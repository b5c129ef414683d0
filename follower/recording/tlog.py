"""`mavlink.tlog`: every MAVLink packet with its time, as Mission Planner and MAVProxy write it.

Each packet follows its time in microseconds since 1970 as eight bytes, big-endian. The two lowest
bits of the time name the link, as MAVProxy has it: 0 is what came from the autopilot, 1 is what we
sent. The time is thereby exact to 4 microseconds.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

from follower.links.packet_parser import PacketReader, next_start, packet_length
from follower.recording.append_file import AppendFile
from follower_vision.sources.frame_source import ClosesItself

SETUP_SIGNING = 256
"""The message that carries a secret key. It is never written."""
_STAMP = struct.Struct(">Q")


class Direction(IntEnum):
    """Which way a packet went."""

    RECEIVED = 0
    SENT = 1


@dataclass(frozen=True, slots=True)
class TlogPacket:
    """One MAVLink packet.

    Attributes:
        time_s: when it was received or sent, on the flight's clock.
        direction: which way it went.
        data: its bytes.
    """

    time_s: float
    direction: Direction
    data: bytes


class TlogWriter(ClosesItself):
    """Writes packets of both directions.

    Raises:
        OSError: the file cannot be made; by `commit`: the disk is full.
    """

    def __init__(self, path: Path, epoch_ns: int) -> None:
        self._file = AppendFile(path)
        self._epoch_us = epoch_ns // 1000
        self._readers = {direction: PacketReader() for direction in Direction}

    def write(self, data: bytes, direction: Direction, time_s: float) -> None:
        """Take bytes as they came from or went to the link; secrets are left out."""
        stamp_us = max(0, self._epoch_us + round(time_s * 1e6)) & ~3 | direction
        for packet in self._readers[direction].feed(data, time_s):
            if packet.message_id != SETUP_SIGNING:
                self._file.write(_STAMP.pack(stamp_us) + packet.data)

    def commit(self) -> None:
        """Put all packets onto the disk."""
        self._file.commit()

    def close(self) -> None:
        """Commit and close."""
        try:
            self._file.commit()
        finally:
            self._file.close()


def read_tlog(
    path: Path, epoch_ns: int = 0, remarks: list[str] | None = None
) -> Iterator[TlogPacket]:
    """Return the packets of a tlog; bytes that are none, or only a part of one, are passed over.

    Args:
        path: the file.
        epoch_ns: the flight's time 0 in nanoseconds since 1970; times are counted from it.
        remarks: gets a sentence, once, if bytes were passed over.

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
        yield TlogPacket(time_s, direction, data[at + 8 : end])
        at = end
    said = f"{passed} bytes of {path.name} are cut off or damaged."
    if passed and remarks is not None and said not in remarks:
        remarks.append(said)


def _record_end(data: bytes, at: int) -> int:
    """Return where the record that begins at `at` ends, 0 if none does or it is not whole."""
    length = packet_length(data, at + 8)
    end = at + 8 + length
    return end if length and end <= len(data) else 0


def _next_record(data: bytes, at: int) -> int:
    """Return where the next record begins that looks like one and has another or the end behind."""
    packet = next_start(data, at + 8)
    while packet < len(data):
        end = _record_end(data, packet - 8)
        # A time since 1970 in microseconds needs seven of its eight bytes for 2000 years to come.
        if end and data[packet - 8] == 0 and (end == len(data) or packet_length(data, end + 8)):
            return packet - 8
        packet = next_start(data, packet + 1)
    return len(data)
