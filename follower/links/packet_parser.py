"""Cuts a stream of bytes into whole MAVLink packets."""

from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.generator.mavcrc import x25crc

_V1, _V2 = 0xFE, 0xFD
_V1_HEAD, _V2_HEAD, _CRC, SIGNATURE = 6, 10, 2, 13
SIGNED_FLAG = 0x01
_FLAGS = (b"", b"\0", bytes((SIGNED_FLAG,)))
"""What may stand in a packet of MAVLink 2 as its incompatibility flags."""
_NOT_YET, _NEVER = 0, -1
_SOON_S = 0.05
"""The longest packet takes as long at 57600 baud; UDP brings packets as a whole."""
_BYTES = [bytes((number,)) for number in range(256)]
_CRC_EXTRA = {number: int(message.crc_extra) for number, message in mavlink.mavlink_map.items()}
_FIXED_SIZE = {
    number: message
    for number, message in mavlink.mavlink_map.items()
    if sum(message.lengths) == len(message.lengths)
}
"""The messages without arrays."""


class MavlinkPacket(NamedTuple):
    """One MAVLink packet whose checksum is right, or cannot be known.

    Attributes:
        system, component: who says that it sent it.
        message_id: what kind of message it is.
        sequence: the sender's count, 0 to 255.
        signed: whether it carries a signature, right or wrong.
        data: all of its bytes.
    """

    system: int
    component: int
    message_id: int
    sequence: int
    signed: bool
    data: bytes

    @property
    def is_known(self) -> bool:
        """Whether the dialect has this message; if not, nothing but its head means anything."""
        return crc_extra_of(self.message_id) is not None


class PacketReader:
    """Finds the packets in a stream that may hold anything.

    After a byte that fits nowhere it goes on at the next one, so that garbage never hides a
    packet behind it. Messages that the dialect does not know cannot be checked: they are packets
    if they come from somebody whose packets were right, and garbage else. What begins like
    a packet and is not complete soon is garbage too.

    Attributes:
        skipped_bytes: how many bytes belonged to no packet.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._came: list[tuple[int, float]] = []
        self._senders: set[tuple[int, int]] = set()
        self.skipped_bytes = 0

    def feed(self, data: bytes, now_s: float = 0.0) -> list[MavlinkPacket]:
        """Take bytes as they came; return the packets that are complete now."""
        if not (data or self._rest):
            return []
        stream = self._rest + data
        self._came.append((len(stream), now_s))
        packets: list[MavlinkPacket] = []
        at = self._skip(stream, 0)
        while (length := self._length(stream, at, now_s)) != _NOT_YET:
            packet = None if length == _NEVER else _packet(stream[at : at + length])
            if packet is not None and _is_right(packet):
                packets.append(packet)
                self._senders.add((packet.system, packet.component))
                at = self._skip(stream, at + length)
            elif packet is not None and self._is_unknown(packet, stream, at + length):
                if at + length == len(stream) and not self._is_overdue(at, now_s):
                    break  # what comes next decides
                packets.append(packet)
                at = self._skip(stream, at + length)
            else:
                self.skipped_bytes += 1
                at = self._skip(stream, at + 1)
        self._rest = stream[at:]
        self._came = [(end - at, came_s) for end, came_s in self._came if end > at]
        return packets

    def _skip(self, stream: bytes, at: int) -> int:
        """Return where the next packet may begin; what lies before it is counted as skipped."""
        start = next_start(stream, at)
        self.skipped_bytes += start - at
        return start

    def _length(self, stream: bytes, at: int, now_s: float) -> int:
        """Return the length of the packet at `at`, if it is complete and can be one."""
        if stream[at : at + 1] == bytes((_V2,)) and stream[at + 2 : at + 3] not in _FLAGS:
            return _NEVER
        length = packet_length(stream, at)
        if length and at + length <= len(stream):
            return length
        return _NEVER if self._is_overdue(at, now_s) else _NOT_YET

    def _is_overdue(self, at: int, now_s: float) -> bool:
        """Whether the byte at `at` came so long ago that the rest should have come too."""
        came_s = next((came_s for end, came_s in self._came if end > at), now_s)
        return now_s - came_s > _SOON_S

    def _is_unknown(self, packet: MavlinkPacket, stream: bytes, end: int) -> bool:
        """Whether this looks like a packet of another dialect: what follows begins one too."""
        if packet.is_known or (packet.system, packet.component) not in self._senders:
            return False
        return end == len(stream) or stream[end] in (_V1, _V2)


def checksum(unsigned: bytes, crc_extra: int) -> bytes:
    """Return the checksum of a packet from its first byte to the end of its payload."""
    crc = x25crc(unsigned[1:] + _BYTES[crc_extra])
    return int(crc.crc).to_bytes(2, "little")


def crc_extra_of(message_id: int) -> int | None:
    """Return the seed of a message's checksum, None if the dialect does not know it."""
    return _CRC_EXTRA.get(message_id)


def message_id_of(packet: bytes) -> int:
    """Return the message's number."""
    return packet[5] if packet[0] == _V1 else int.from_bytes(packet[7:10], "little")


def next_start(stream: bytes, at: int) -> int:
    """Return where from `at` on the next packet may begin, the stream's end if nowhere."""
    if at < len(stream) and stream[at] in (_V1, _V2):
        return at
    starts = [i for i in (stream.find(_V1, at), stream.find(_V2, at)) if i >= 0]
    return min(starts, default=len(stream))


def packet_length(stream: bytes, at: int) -> int:
    """Return how many bytes the packet at `at` has, 0 if none begins or its head is incomplete."""
    if len(stream) < at + 3 or stream[at] not in (_V1, _V2):
        return 0
    version, payload, flags = stream[at : at + 3]
    if version == _V1:
        return _V1_HEAD + payload + _CRC
    return _V2_HEAD + payload + _CRC + (SIGNATURE if flags & SIGNED_FLAG else 0)


def _is_right(packet: MavlinkPacket) -> bool:
    """Whether this is a packet of a known message with the right checksum."""
    crc_extra = crc_extra_of(packet.message_id)
    if crc_extra is None:
        return False
    body = packet.data[:-SIGNATURE] if packet.signed else packet.data
    return checksum(body[:-2], crc_extra) == body[-2:]


def _packet(data: bytes) -> MavlinkPacket:
    if data[0] == _V1:
        sequence, system, component = data[2:5]
        return MavlinkPacket(system, component, data[5], sequence, False, data)
    sequence, system, component = data[4:7]
    signed = bool(data[2] & SIGNED_FLAG)
    return MavlinkPacket(system, component, message_id_of(data), sequence, signed, data)


class Unpacker:
    """Unpacks messages of one vehicle; who sent them is in the packet, not in the message.

    `pymavlink` would compute each checksum once more, which takes longer than all the rest.
    """

    def __init__(self) -> None:
        self._codec = mavlink.MAVLink(None)

    def message(self, packet: MavlinkPacket) -> Any:
        """Return the message of a packet whose checksum is right."""
        kind = _FIXED_SIZE.get(packet.message_id)
        if kind is None:
            return self._codec.decode(bytearray(packet.data))
        start = _V1_HEAD if packet.data[0] == _V1 else _V2_HEAD
        size = kind.unpacker.size
        payload = packet.data[start : start + packet.data[1]][:size]
        values = kind.unpacker.unpack(payload.ljust(size, b"\0"))
        return kind(*[values[i] for i in kind.orders])
