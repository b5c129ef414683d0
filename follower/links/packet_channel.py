"""Whole packets in both directions, signed where there is a key."""

import threading
from collections import Counter, deque
from collections.abc import Callable

from follower.links.packet_parser import MavlinkPacket, PacketReader
from follower.links.signing import Signer
from follower_control.common.transport import Transport

_MOST_PACKETS = 500
_MODULUS = 256
_BACK = 128
"""A number that is less behind than ahead is a late packet, not a gap of half the numbers."""


class PacketChannel:
    """Stands between a transport's bytes and a link.

    Sending is allowed from any thread, receiving from one at a time.

    Args:
        transport: carries the bytes.
        signer: signs what leaves and checks what comes; None does neither.

    Attributes:
        received: packets that were believed.
        refused: how many packets were not, by the reason.
        tap: receives every packet that is believed, on the thread that receives.
    """

    def __init__(self, transport: Transport, signer: Signer | None = None) -> None:
        self._transport = transport
        self._signer = signer
        self._reader = PacketReader()
        self._using = threading.Lock()
        self._now_s = 0.0
        self.received = 0
        self.refused: Counter[str] = Counter()
        self.tap: Callable[[MavlinkPacket], None] | None = None

    @property
    def skipped_bytes(self) -> int:
        """How many bytes that came belonged to no packet."""
        return self._reader.skipped_bytes

    def receive(self, now_s: float) -> list[MavlinkPacket]:
        """Return the packets that have come and are believed."""
        self._now_s = now_s
        with self._using:  # receiving, too, sends on what a slow line had no room for
            data = self._transport.receive()
        packets = self._reader.feed(data, now_s)
        believed = [packet for packet in packets if self._believes(packet)]
        self.received += len(believed)
        if self.tap is not None:
            for packet in believed:
                self.tap(packet)
        return believed

    def send(self, packet: bytes) -> None:
        """Send one unsigned packet, signed if there is a key."""
        with self._using:
            if self._signer is not None:
                packet = self._signer.sign(packet, self._now_s)
            self._transport.send(packet)

    def close(self) -> None:
        """Close the transport."""
        self._transport.close()

    def _believes(self, packet: MavlinkPacket) -> bool:
        if self._signer is None:
            return True
        with self._using:
            refusal = self._signer.refusal(packet, self._now_s)
        if refusal is not None:
            self.refused[refusal] += 1
        return refusal is None


class PacketPort:
    """Copies of what comes over a link, and a way to send over it.

    Whoever receives for the link hands packets over in microseconds and never waits; what nobody
    takes in time is dropped, the oldest first.

    Args:
        message_ids: what is copied.
        send: sends a packet over the link, from any thread.
    """

    def __init__(self, message_ids: frozenset[int], send: Callable[[bytes], None]) -> None:
        self._message_ids = message_ids
        self._packets: deque[MavlinkPacket] = deque(maxlen=_MOST_PACKETS)
        self._arrived = threading.Event()
        self.send = send

    def receive(self, packet: MavlinkPacket) -> None:
        """Take a copy; for the thread that receives."""
        if packet.message_id in self._message_ids:
            self._packets.append(packet)
            self._arrived.set()

    def wait(self, timeout_s: float) -> list[MavlinkPacket]:
        """Wait for packets, at most `timeout_s` seconds, and return those that have come."""
        self._arrived.wait(timeout_s)
        self._arrived.clear()
        return [self._packets.popleft() for _ in range(len(self._packets))]


class SequenceCounter:
    """Counts what one sender sent and we got, or never did.

    Attributes:
        came: packets that came, each once.
        lost: packets that are missing.
    """

    def __init__(self) -> None:
        self._newest: int | None = None
        self.came = self.lost = 0

    def count(self, sequence: int) -> None:
        """Take the number of a packet that came."""
        ahead = 1 if self._newest is None else (sequence - self._newest) % _MODULUS
        self.came += ahead > 0
        if ahead >= _MODULUS - _BACK:
            self.lost = max(0, self.lost - 1)
        elif ahead > 0:
            self.lost += ahead - 1
            self._newest = sequence
