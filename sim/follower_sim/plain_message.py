"""The short way between bytes and messages, for the packets that come all the time."""

from __future__ import annotations

import struct
from operator import attrgetter
from typing import Any

from pymavlink.dialects.v20 import common as mavlink
from pymavlink.generator.mavcrc import x25crc

_V2, _HEAD, _CRC = 0xFD, 10, 2
FRAME_BYTES = _HEAD + _CRC
"""So much longer than its payload is an unsigned packet."""

_HEADER = struct.Struct("<BBBBBBBHB")
_KINDS = {
    number: kind
    for number, kind in mavlink.mavlink_map.items()
    if sum(kind.lengths) == len(kind.lengths)
}
_FIELDS = {
    number: attrgetter(*kind.ordered_fieldnames)
    for number, kind in _KINDS.items()
    if len(kind.fieldnames) > 1 and not any(kind.array_lengths)
}
"""Returns the numbers of a message in the order of the wire, of one that has several."""


def packed(message: Any, codec: Any) -> bytes:
    """Return the MAVLink 2 packet of a message, as pymavlink packs it; `codec` does not sign."""
    number = message.get_msgId()
    fields, kind = _FIELDS.get(number), _KINDS.get(number)
    if fields is None or kind is None:
        return bytes(message.pack(codec))
    payload = kind.unpacker.pack(*fields(message)).rstrip(b"\0") or b"\0"
    sender = codec.seq, codec.srcSystem, codec.srcComponent
    head = _HEADER.pack(_V2, len(payload), 0, 0, *sender, number & 0xFFFF, number >> 16)
    crc = x25crc(head[1:] + payload + bytes((kind.crc_extra,)))
    return head + payload + int(crc.crc).to_bytes(_CRC, "little")


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
