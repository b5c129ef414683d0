"""The seam between MAVLink and whatever carries its bytes."""

from __future__ import annotations

from collections import deque
from typing import Protocol


class Transport(Protocol):
    """Carries bytes to and from one peer; never blocks."""

    def send(self, data: bytes) -> None:
        """Send one packet. A packet that cannot be sent now is dropped, as UDP does."""
        ...

    def receive(self) -> bytes:
        """Return what has arrived since the last call, b"" if nothing has."""
        ...

    def close(self) -> None:
        """Release the port; sending and receiving end."""
        ...


class MemoryTransport:
    """One end of a pair in memory: lockstep runs, where the kernel's timing must not matter."""

    def __init__(self, inbox: deque[bytes], outbox: deque[bytes]) -> None:
        self._inbox = inbox
        self._outbox = outbox

    @classmethod
    def pair(cls) -> tuple[MemoryTransport, MemoryTransport]:
        """Make the two ends."""
        a: deque[bytes] = deque()
        b: deque[bytes] = deque()
        return cls(a, b), cls(b, a)

    def send(self, data: bytes) -> None:
        """Put a packet into the other end's inbox."""
        self._outbox.append(bytes(data))

    def receive(self) -> bytes:
        """Return all that the other end has sent."""
        if not self._inbox:
            return b""
        data = b"".join(self._inbox)
        self._inbox.clear()
        return data

    def close(self) -> None:
        """Forget what has arrived."""
        self._inbox.clear()
