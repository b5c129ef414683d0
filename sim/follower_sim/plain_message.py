"""The short way from bytes to a message, for the packets that come all the time."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink
from pymavlink.generator.mavcrc import x25crc

_V2, _HEAD, _CRC = 0xFD, 10, 2
FRAME_BYTES = _HEAD + _CRC
"""So much longer than its payload is an unsigned packet."""

_KINDS = {
    number: kind
    for number, kind in mavlink.mavlink_map.items()
    if sum(kind.lengths) == len(kind.lengths)
}


def plain_message(data: bytes) -> Any | None:
    """Return the message at the start of some bytes.

    None if that is not a whole, unsigned, right MAVLink 2 packet of a message without arrays.
    """
    if len(data) < FRAME_BYTES or data[0] != _V2 or data[2] or len(data) < FRAME_BYTES + data[1]:
        return None
    kind, end = _KINDS.get(int.from_bytes(data[7:_HEAD], "little")), _HEAD + data[1]
    if kind is None:
        return None
    crc = x25crc(data[1:end] + bytes((kind.crc_extra,)))
    if crc.crc != int.from_bytes(data[end : end + _CRC], "little"):
        return None
    size = kind.unpacker.size
    values = kind.unpacker.unpack(data[_HEAD:end][:size].ljust(size, b"\0"))
    message = kind(*[values[i] for i in kind.orders])
    header = message.get_header()
    header.mlen, header.seq, header.srcSystem, header.srcComponent = data[1], *data[4:7]
    return message
