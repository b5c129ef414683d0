"""A second use of a link, by a thread of its own, beside the one that polls it."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from follower.links.packets import Packet

_MOST_PACKETS = 500


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
        self._packets: deque[Packet] = deque(maxlen=_MOST_PACKETS)
        self._arrived = threading.Event()
        self.send = send

    def hear(self, packet: Packet) -> None:
        """Take a copy; for the thread that receives."""
        if packet.message_id in self._message_ids:
            self._packets.append(packet)
            self._arrived.set()

    def wait(self, timeout_s: float) -> list[Packet]:
        """Wait for packets, and return those that have come."""
        self._arrived.wait(timeout_s)
        self._arrived.clear()
        return [self._packets.popleft() for _ in range(len(self._packets))]
