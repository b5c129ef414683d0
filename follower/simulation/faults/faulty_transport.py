"""A transport that loses, delays and falsifies packets."""

import math
import threading
from collections import deque
from collections.abc import Callable
from typing import Protocol

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from follower.links.packet_parser import PacketReader
from follower.links.signing import Signer, SigningKey
from follower.simulation.faults.fault import FaultAction, FaultKind
from follower_control.common.transport import Transport, WrappedTransport
from follower_vision.clock import Clock

_REPLAYED_AFTER = 200
_VEHICLE = 1
"""The system id in whose name forgeries come."""
_WRONG_SECRET = bytes(range(100, 132))


class HostilePackets:
    """Makes garbage, strangers, forgeries and replays."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._heard: deque[bytes] = deque(maxlen=2 * _REPLAYED_AFTER)
        self._wrong_signer = Signer(SigningKey(_WRONG_SECRET), 1_790_000_000 * 10**9)

    def keep(self, packet: bytes) -> None:
        """Keep a true packet, to send it again."""
        self._heard.append(packet)

    def garbage(self) -> bytes:
        """Return bytes that are no packet, the first bytes of packets among them."""
        noise = bytearray(self._rng.bytes(int(self._rng.integers(1, 40))))
        noise[int(self._rng.integers(len(noise)))] = int(self._rng.choice([0xFD, 0xFE]))
        return bytes(noise)

    def stranger(self) -> bytes:
        """Return a packet of another system, or of another component of the vehicle."""
        system, component = ((66, 1), (_VEHICLE, 154), (255, 190))[self._rng.integers(3)]
        return self.forged(system, component)

    def forged_signed(self, now_s: float) -> bytes:
        """Return a packet in the vehicle's own name, signed with another key."""
        return self._wrong_signer.sign(self.forged(_VEHICLE, 1), now_s)

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

    def forged(self, system: int, component: int) -> bytes:
        """Return an unsigned packet in the name of a system's component."""
        number = self._rng.integers(0, 256, 4).tolist()
        beat = mavlink.MAVLink_heartbeat_message(2, int(self._rng.choice([3, 12])), 1, 4, 3, 3)
        wild = [float(x) for x in self._rng.normal(0.0, 50.0, 6)]
        forgeries = (
            beat,
            mavlink.MAVLink_attitude_message(number[0], *wild),
            mavlink.MAVLink_local_position_ned_message(number[1], *wild),
            mavlink.MAVLink_attitude_message(number[2], *(math.nan,) * 6),
            mavlink.MAVLink_timesync_message(number[3] + 1, 1),
            mavlink.MAVLink_extended_sys_state_message(0, 1),
        )
        message = forgeries[int(self._rng.integers(len(forgeries)))]
        return bytes(message.pack(mavlink.MAVLink(None, system, component)))


_OTHERS = 5
"""A packet that is reordered comes behind so many others."""


class FaultSource(Protocol):
    """Knows which fault is on."""

    def active(self, kind: FaultKind, now_s: float) -> FaultAction | None:
        """Return the action of this kind that is on, None if none is."""
        ...


class _Way:
    """One direction: loses, doubles, reorders and delays packets."""

    def __init__(self, schedule: FaultSource, rng: np.random.Generator, delays: bool) -> None:
        self._schedule = schedule
        self._rng = rng
        self._delays = delays
        self._kept: deque[tuple[int, bytes]] = deque()
        self._late: deque[tuple[float, bytes]] = deque()
        self._seen = 0

    def carry(self, packets: list[bytes], now_s: float) -> list[bytes]:
        """Return what arrives now of these packets and of those before."""
        if self._schedule.active(FaultKind.LINK_DOWN, now_s) is not None:
            return []
        arriving: list[bytes] = []
        for packet in packets:
            arriving += self._shaken(packet, now_s)
        late = self._schedule.active(FaultKind.TELEMETRY_LATE, now_s) if self._delays else None
        if late is not None:
            self._late += [(now_s + late.amount, packet) for packet in arriving]
            arriving = []
        while self._late and (self._late[0][0] <= now_s or late is None):
            arriving.append(self._late.popleft()[1])
        return arriving

    def _shaken(self, packet: bytes, now_s: float) -> list[bytes]:
        self._seen += 1
        due: list[bytes] = []
        while self._kept and self._kept[0][0] <= self._seen:
            due.append(self._kept.popleft()[1])
        if self._happens(FaultKind.PACKETS_LOST, now_s):
            return due
        if self._happens(FaultKind.PACKETS_REORDERED, now_s):
            self._kept.append((self._seen + _OTHERS, packet))
            return due
        again = [packet] if self._happens(FaultKind.PACKETS_DOUBLED, now_s) else []
        return [packet, *again, *due]

    def _happens(self, kind: FaultKind, now_s: float) -> bool:
        action = self._schedule.active(kind, now_s)
        return action is not None and float(self._rng.random()) < action.amount


class FaultyTransport(WrappedTransport):
    """The follower's transport with the faults of the link in it, both ways."""

    def __init__(
        self, inner: Transport, schedule: FaultSource, clock: Clock, rng: np.random.Generator
    ) -> None:
        super().__init__(inner)
        self._schedule = schedule
        self._clock = clock
        self._reader = PacketReader()
        self._lock = threading.Lock()
        there, back, self._rng = rng.spawn(3)
        self._there = _Way(schedule, there, delays=False)
        self._back = _Way(schedule, back, delays=True)
        self._hostile = hostile = HostilePackets(self._rng)
        self._forgeries: dict[FaultKind, Callable[[float], bytes]] = {
            FaultKind.GARBAGE: lambda _: hostile.garbage(),
            FaultKind.STRANGERS: lambda _: hostile.stranger(),
            FaultKind.FUZZED: lambda _: hostile.fuzzed(),
            FaultKind.FORGED_UNSIGNED: lambda _: hostile.forged(_VEHICLE, 1),
            FaultKind.FORGED_WRONG: hostile.forged_signed,
            FaultKind.REPLAYED: lambda _: hostile.replayed(),
        }

    def send(self, data: bytes) -> None:
        """Send a packet, or not, or twice, or later."""
        with self._lock:
            packets = self._there.carry([data], self._clock.now())
        for packet in packets:
            super().send(packet)

    def receive(self) -> bytes:
        """Return what has arrived, and what was slipped in."""
        now_s = self._clock.now()
        packets = [packet.data for packet in self._reader.feed(super().receive())]
        for packet in packets:
            self._hostile.keep(packet)
        with self._lock:
            arriving = self._back.carry(packets, now_s)
        return b"".join(self._between(arriving, now_s))

    def _between(self, packets: list[bytes], now_s: float) -> list[bytes]:
        forgeries = [
            forge for kind, forge in self._forgeries.items() if self._schedule.active(kind, now_s)
        ]
        mixed = [*packets]
        for forge in (*forgeries, *forgeries):
            mixed.insert(int(self._rng.integers(len(mixed) + 1)), forge(now_s))
        return mixed
