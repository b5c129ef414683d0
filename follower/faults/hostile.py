"""Packets that mean harm."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from follower.links.signing import Signer
from follower.links.signing_key import SigningKey

_REPLAYED_AFTER = 200
_WRONG_SECRET = bytes(range(100, 132))


class HostilePackets:
    """Makes garbage, strangers, forgeries and replays.

    Args:
        rng: chooses.
        vehicle: the system id in whose name forgeries come.
    """

    def __init__(self, rng: np.random.Generator, vehicle: int = 1) -> None:
        self._rng = rng
        self._vehicle = vehicle
        self._heard: deque[bytes] = deque(maxlen=2 * _REPLAYED_AFTER)
        self._liar = Signer(SigningKey(_WRONG_SECRET), 1_790_000_000 * 10**9)

    def hear(self, packet: bytes) -> None:
        """Keep a true packet, to send it again."""
        self._heard.append(packet)

    def garbage(self) -> bytes:
        """Return bytes that are no packet, the first bytes of packets among them."""
        noise = bytearray(self._rng.bytes(int(self._rng.integers(1, 40))))
        noise[int(self._rng.integers(len(noise)))] = int(self._rng.choice([0xFD, 0xFE]))
        return bytes(noise)

    def stranger(self) -> bytes:
        """Return a packet of another system, or of another component of the vehicle."""
        system, component = ((66, 1), (self._vehicle, 154), (255, 190))[self._rng.integers(3)]
        return self._lie(system, component)

    def forged(self) -> bytes:
        """Return an unsigned packet in the vehicle's own name."""
        return self._lie(self._vehicle, 1)

    def forged_signed(self, now_s: float) -> bytes:
        """Return a packet in the vehicle's own name, signed with another key."""
        return self._liar.sign(self.forged(), now_s)

    def fuzzed(self) -> bytes:
        """Return a true packet with one to four bytes changed behind its start."""
        if not self._heard:
            return b""
        data = bytearray(self._heard[int(self._rng.integers(len(self._heard)))])
        for _ in range(int(self._rng.integers(1, 5))):
            at = int(self._rng.integers(1, len(data)))
            data[at] ^= int(self._rng.integers(1, 256))
        return bytes(data)

    def replayed(self) -> bytes:
        """Return a true packet of some seconds ago, just as it was."""
        return self._heard[0] if len(self._heard) >= _REPLAYED_AFTER else b""

    def _lie(self, system: int, component: int) -> bytes:
        number = self._rng.integers(0, 256, 4).tolist()
        beat = mavlink.MAVLink_heartbeat_message(2, int(self._rng.choice([3, 12])), 1, 4, 3, 3)
        wild = [float(x) for x in self._rng.normal(0.0, 50.0, 6)]
        lies = (
            beat,
            mavlink.MAVLink_attitude_message(number[0], *wild),
            mavlink.MAVLink_local_position_ned_message(number[1], *wild),
            mavlink.MAVLink_attitude_message(number[2], *(math.nan,) * 6),
            mavlink.MAVLink_timesync_message(number[3] + 1, 1),
            mavlink.MAVLink_extended_sys_state_message(0, 1),
        )
        message = lies[int(self._rng.integers(len(lies)))]
        return bytes(message.pack(mavlink.MAVLink(None, system, component)))
