"""The seam between MAVLink and whatever carries its bytes."""

from __future__ import annotations

import contextlib
import errno
import socket
from collections import deque
from typing import Protocol

_LOOPBACK = "127.0.0.1"
_LARGEST_DATAGRAM = 9000
_RECEIVE_BUFFER = 1 << 20  # the default overruns in a burst of 400 messages
_MOST_PEERS = 8
_MOST_AT_ONCE, MOST_BYTES = 256, 1 << 14
"""Datagrams, and bytes: who floods a link does not hold up the control loop that listens there, and
looks for packets in whatever comes."""


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


class WrappedTransport:
    """Does the same as another transport; its subclasses do a little more, or a little less."""

    def __init__(self, inner: Transport) -> None:
        self._inner = inner

    def send(self, data: bytes) -> None:
        """Send one packet."""
        self._inner.send(data)

    def receive(self) -> bytes:
        """Return what has arrived."""
        return self._inner.receive()

    def close(self) -> None:
        """Close the transport."""
        self._inner.close()


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


class UdpTransport:
    """Peers over UDP, never blocking; a `Transport`.

    Make one by `listen` (answers everybody who has spoken) or by `connect` (speaks first). A
    listener answers the last eight addresses, so that a stranger cannot draw the stream away from
    the vehicle; each vehicle takes only what is addressed to it.
    """

    def __init__(self, sock: socket.socket, peer: tuple[str, int] | None) -> None:
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        self._socket = sock
        self._listens = peer is None
        self._peers: tuple[tuple[str, int], ...] = () if peer is None else (peer,)

    @classmethod
    def listen(cls, host: str, port: int) -> UdpTransport:
        """Bind a port, 0 for any free one.

        Raises:
            OSError: the port is in use, or the address is not this machine's.
        """
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            sock.bind((host, port))
        except OSError:
            sock.close()
            raise
        return cls(sock, None)

    @classmethod
    def connect(cls, host: str, port: int) -> UdpTransport:
        """Speak to a known address from any free port.

        Raises:
            OSError: the host's name is not known.
        """
        address = socket.gethostbyname(host)
        return cls(socket.socket(socket.AF_INET, socket.SOCK_DGRAM), (address, port))

    @classmethod
    def pair(cls, preferred_port: int = 0) -> tuple[UdpTransport, UdpTransport]:
        """Return a listener on this computer, and who speaks to it first.

        Args:
            preferred_port: the listener's, if it is free; any free one otherwise.
        """
        try:
            listener = cls.listen(_LOOPBACK, preferred_port)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise
            listener = cls.listen(_LOOPBACK, 0)
        return listener, cls.connect(_LOOPBACK, listener.port)

    @property
    def port(self) -> int:
        """The local port, 0 before the first packet was sent."""
        return int(self._socket.getsockname()[1])

    def send(self, data: bytes) -> None:
        """Send one datagram; dropped while there is no peer or the network takes none."""
        for peer in self._peers:
            # Whatever the network says (a peer that has gone, a buffer that is full, a cable that
            # was pulled), for UDP it is a lost packet.
            with contextlib.suppress(OSError):
                self._socket.sendto(data, peer)

    def receive(self) -> bytes:
        """Return what has arrived, of a flood the oldest part."""
        parts: list[bytes] = []
        room = MOST_BYTES
        while room > 0 and len(parts) < _MOST_AT_ONCE:
            try:
                data, sender = self._socket.recvfrom(_LARGEST_DATAGRAM)
            except OSError:
                break
            if self._listens and sender not in self._peers[:1]:
                others = tuple(peer for peer in self._peers if peer != sender)
                self._peers = (sender, *others[: _MOST_PEERS - 1])
            parts.append(data)
            room -= len(data)
        return b"".join(parts)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
