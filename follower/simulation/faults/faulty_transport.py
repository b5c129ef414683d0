"""The link's bytes on a bad way."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Protocol

import numpy as np

from follower.faults.fault import Action, Kind
from follower.faults.hostile import HostilePackets
from follower.links.packets import PacketReader
from follower_control.transport import Transport
from follower_vision.clock import Clock

_OTHERS = 5
"""A packet that is reordered comes behind so many others."""


class FaultSource(Protocol):
    """Knows which fault is on."""

    def active(self, kind: Kind, now_s: float) -> Action | None:
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
        if self._schedule.active(Kind.LINK_DOWN, now_s) is not None:
            return []
        arriving: list[bytes] = []
        for packet in packets:
            arriving += self._shaken(packet, now_s)
        late = self._schedule.active(Kind.TELEMETRY_LATE, now_s) if self._delays else None
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
        if self._happens(Kind.PACKETS_LOST, now_s):
            return due
        if self._happens(Kind.PACKETS_REORDERED, now_s):
            self._kept.append((self._seen + _OTHERS, packet))
            return due
        again = [packet] if self._happens(Kind.PACKETS_DOUBLED, now_s) else []
        return [packet, *again, *due]

    def _happens(self, kind: Kind, now_s: float) -> bool:
        action = self._schedule.active(kind, now_s)
        return action is not None and float(self._rng.random()) < action.amount


class FaultyTransport:
    """The follower's transport with the faults of the link in it, both ways.

    Args:
        inner: carries the bytes.
        schedule: says what is on.
        clock: the flight's.
        rng: decides which packets are hit.
    """

    def __init__(
        self, inner: Transport, schedule: FaultSource, clock: Clock, rng: np.random.Generator
    ) -> None:
        self._inner = inner
        self._schedule = schedule
        self._clock = clock
        self._reader = PacketReader()
        self._lock = threading.Lock()
        there, back, self._lots = rng.spawn(3)
        self._there = _Way(schedule, there, delays=False)
        self._back = _Way(schedule, back, delays=True)
        hostile = HostilePackets(self._lots)
        self._hostile = hostile
        self._lies: dict[Kind, Callable[[float], bytes]] = {
            Kind.GARBAGE: lambda _: hostile.garbage(),
            Kind.STRANGERS: lambda _: hostile.stranger(),
            Kind.FUZZED: lambda _: hostile.fuzzed(),
            Kind.FORGED_UNSIGNED: lambda _: hostile.forged(),
            Kind.FORGED_WRONG: hostile.forged_signed,
            Kind.REPLAYED: lambda _: hostile.replayed(),
        }

    def send(self, data: bytes) -> None:
        """Send a packet, or not, or twice, or later."""
        with self._lock:
            packets = self._there.carry([data], self._clock.now())
        for packet in packets:
            self._inner.send(packet)

    def receive(self) -> bytes:
        """Return what has arrived, and what was slipped in."""
        now_s = self._clock.now()
        packets = [packet.data for packet in self._reader.feed(self._inner.receive())]
        for packet in packets:
            self._hostile.hear(packet)
        with self._lock:
            arriving = self._back.carry(packets, now_s)
        return b"".join(self._between(arriving, now_s))

    def close(self) -> None:
        """Close the transport."""
        self._inner.close()

    def _between(self, packets: list[bytes], now_s: float) -> list[bytes]:
        lies = [lie for kind, lie in self._lies.items() if self._schedule.active(kind, now_s)]
        mixed = [*packets]
        for lie in (*lies, *lies):
            mixed.insert(int(self._lots.integers(len(mixed) + 1)), lie(now_s))
        return mixed
