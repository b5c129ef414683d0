"""Whole packets in both directions, signed where there is a key."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable

from follower.links.packets import Packet, PacketReader
from follower.links.signing import Signer
from follower_control.transport import Transport


class PacketChannel:
    """Stands between a transport's bytes and a link.

    Sending is allowed from any thread, receiving from one at a time.

    Args:
        transport: carries the bytes.
        signer: signs what leaves and checks what comes; None does neither.

    Attributes:
        received: packets that were believed.
        refused: how many packets were not, by the reason.
        tap: is shown every packet that is believed, on the thread that receives.
    """

    def __init__(self, transport: Transport, signer: Signer | None = None) -> None:
        self._transport = transport
        self._signer = signer
        self._reader = PacketReader()
        self._using = threading.Lock()
        self._now_s = 0.0
        self.received = 0
        self.refused: Counter[str] = Counter()
        self.tap: Callable[[Packet], None] | None = None

    @property
    def skipped_bytes(self) -> int:
        """How many bytes that came belonged to no packet."""
        return self._reader.skipped_bytes

    def receive(self, now_s: float) -> list[Packet]:
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

    def _believes(self, packet: Packet) -> bool:
        if self._signer is None:
            return True
        with self._using:
            refusal = self._signer.refusal(packet, self._now_s)
        if refusal is not None:
            self.refused[refusal] += 1
        return refusal is None
