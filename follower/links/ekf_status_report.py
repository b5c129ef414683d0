"""EKF_STATUS_REPORT, which is in ArduPilot's dialect alone."""

from __future__ import annotations

import struct
from dataclasses import dataclass

MESSAGE_ID = 193
NAME = "EKF_STATUS_REPORT"
CRC_EXTRA = 71
_FIELDS = struct.Struct("<fffffH")
_V1_HEAD, _V2_HEAD = 6, 10


@dataclass(frozen=True, slots=True)
class EkfStatusReport:
    """The message's fields; what it calls variances are innovations over their limits."""

    velocity_variance: float
    pos_horiz_variance: float
    pos_vert_variance: float
    compass_variance: float
    terrain_alt_variance: float
    flags: int


def decode(packet: bytes) -> EkfStatusReport:
    """Read a whole packet whose checksum is right; trailing zeros may have been cut off."""
    head = _V2_HEAD if packet[0] == 0xFD else _V1_HEAD
    payload = packet[head : head + packet[1]][: _FIELDS.size]
    return EkfStatusReport(*_FIELDS.unpack(payload.ljust(_FIELDS.size, b"\0")))
