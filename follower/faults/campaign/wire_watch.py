"""Looks at every packet that leaves or reaches the follower, cheaply, with eyes of its own."""

from __future__ import annotations

import struct

from pymavlink.generator.mavcrc import x25crc

from follower.faults.evidence import WireSetpoint
from follower_control.transport import Transport

_SETPOINT = 84
_HEAD, _SETPOINT_LENGTH = 10, 53
_SETPOINT_FIELDS = struct.Struct("<I11fHBBB")
_HEARTBEAT_LENGTH, _HEARTBEAT_SEED = 9, 50
_FROM_VEHICLE = bytes((1, 1, 0, 0, 0))
"""System, component and message id, as they stand in a heartbeat's head."""


class WireWatch:
    """A transport of the follower's that notes set-points sent and heartbeats heard.

    Packets are taken apart by their bytes, without anybody's MAVLink parser. It stands before the
    faults: what it sees arrive is what the follower gets.

    Attributes:
        now_s: set from outside.
        setpoints: that left; whoever reads them empties the list.
        modes: `custom_mode` of the vehicle's heartbeats that came; likewise.
    """

    def __init__(self, inner: Transport) -> None:
        self._inner = inner
        self.now_s = 0.0
        self.setpoints: list[WireSetpoint] = []
        self.modes: list[int] = []

    def send(self, data: bytes) -> None:
        """Send one packet and look at it."""
        if int.from_bytes(data[7:10], "little") == _SETPOINT:
            self.setpoints.append(setpoint_in(data, self.now_s))
        self._inner.send(data)

    def receive(self) -> bytes:
        """Return what has arrived, after a look for heartbeats."""
        data = self._inner.receive()
        at = data.find(_FROM_VEHICLE)
        while at >= 0:
            self._look(data[max(0, at - 5) : at + 16])
            at = data.find(_FROM_VEHICLE, at + 1)
        return data

    def close(self) -> None:
        """Close the transport."""
        self._inner.close()

    def _look(self, packet: bytes) -> None:
        whole = len(packet) == _HEAD + _HEARTBEAT_LENGTH + 2
        if not whole or packet[0] != 0xFD or packet[1] != _HEARTBEAT_LENGTH:
            return
        checksum = int(x25crc(packet[1:-2] + bytes((_HEARTBEAT_SEED,))).crc)
        if checksum == int.from_bytes(packet[-2:], "little"):
            self.modes.append(int.from_bytes(packet[_HEAD : _HEAD + 4], "little"))


def setpoint_in(data: bytes, now_s: float) -> WireSetpoint:
    """Return the set-point that a packet of that message carries."""
    payload = data[_HEAD : _HEAD + data[1]].ljust(_SETPOINT_LENGTH, b"\0")
    fields = _SETPOINT_FIELDS.unpack(payload)
    vx, vy, vz = fields[4:7]
    return WireSetpoint(now_s, fields[15], fields[12], (vx, vy, vz, fields[11]))
