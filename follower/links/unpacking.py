"""From a packet whose checksum was looked at already to its message."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower.links.packets import Packet

_V1, _V1_HEAD, _V2_HEAD = 0xFE, 6, 10


def _has_arrays(kind: Any) -> bool:
    return bool(sum(kind.lengths) != len(kind.lengths))


_PLAIN = {number: kind for number, kind in mavlink.mavlink_map.items() if not _has_arrays(kind)}


class Unpacker:
    """Unpacks messages of one vehicle; who sent them is in the packet, not in the message.

    `pymavlink` would compute each checksum once more, which takes longer than all the rest.
    """

    def __init__(self) -> None:
        self._codec = mavlink.MAVLink(None)

    def message(self, packet: Packet) -> Any:
        """Return the message of a packet whose checksum is right."""
        kind = _PLAIN.get(packet.message_id)
        if kind is None:
            return self._codec.decode(bytearray(packet.data))
        start = _V1_HEAD if packet.data[0] == _V1 else _V2_HEAD
        size = kind.unpacker.size
        payload = packet.data[start : start + packet.data[1]][:size]
        values = kind.unpacker.unpack(payload.ljust(size, b"\0"))
        return kind(*[values[i] for i in kind.orders])
