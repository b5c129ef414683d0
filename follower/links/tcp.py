"""MAVLink over TCP, as ArduPilot's SITL and some radios offer it."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable

from follower_vision.clock import Clock, MonotonicClock

_CHUNK, _MOST_CHUNKS = 65536, 4
_MOST_WAITING = 65536
_RETRY_S = 1.0
_CONNECT_S = 3.0


class TcpTransport:
    """One peer over TCP, never blocking once it is open; a `Transport`.

    Make one by `connect` (it calls) or `listen` (it is called; one peer at a time). After the
    connection breaks it is taken up again, once a second; meanwhile what is sent is lost, as with
    UDP. A peer that reads too slowly loses whole packets, not parts.
    """

    def __init__(
        self,
        open_again: Callable[[], socket.socket | None],
        sock: socket.socket | None,
        clock: Clock,
        listener: socket.socket | None = None,
    ) -> None:
        self._open_again = open_again
        self._listener = listener
        self._clock = clock
        self._tried_s = clock.now()
        self._waiting = bytearray()
        self._socket: socket.socket | None = None
        self._take(sock)

    @classmethod
    def connect(cls, host: str, port: int, clock: Clock | None = None) -> TcpTransport:
        """Call a listening peer.

        Raises:
            OSError: the name is not known, or nobody listens there.
        """
        address = socket.gethostbyname(host), port
        sock = socket.create_connection(address, _CONNECT_S)
        return cls(lambda: _call(address), sock, clock or MonotonicClock())

    @classmethod
    def listen(cls, host: str, port: int, clock: Clock | None = None) -> TcpTransport:
        """Wait for a peer's call on a port, 0 for any free one.

        Raises:
            OSError: the port is in use, or the address is not this machine's.
        """
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((host, port))
            listener.listen(1)
            listener.setblocking(False)
        except OSError:
            listener.close()
            raise
        return cls(lambda: _accept(listener), None, clock or MonotonicClock(), listener)

    @property
    def port(self) -> int:
        """The local port."""
        sock = self._listener or self._socket
        return 0 if sock is None else int(sock.getsockname()[1])

    def send(self, data: bytes) -> None:
        """Send one packet, or drop it whole."""
        if self._socket is None or len(self._waiting) + len(data) > _MOST_WAITING:
            return
        self._waiting += data
        self._flush()

    def receive(self) -> bytes:
        """Return what has arrived, of a flood the oldest part."""
        if self._socket is None:
            self._reopen()
        self._flush()
        parts: list[bytes] = []
        for _ in range(_MOST_CHUNKS):
            if self._socket is None:
                break
            try:
                data = self._socket.recv(_CHUNK)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            if not data:
                self._drop()
            parts.append(data)
        return b"".join(parts)

    def close(self) -> None:
        """Hang up."""
        self._drop()
        if self._listener is not None:
            self._listener.close()

    def _flush(self) -> None:
        if self._socket is None or not self._waiting:
            return
        try:
            sent = self._socket.send(self._waiting)
            del self._waiting[:sent]
        except BlockingIOError:
            return
        except OSError:
            self._drop()

    def _reopen(self) -> None:
        now_s = self._clock.now()
        if self._listener is not None or now_s - self._tried_s >= _RETRY_S:
            self._tried_s = now_s
            with contextlib.suppress(OSError):
                self._take(self._open_again())

    def _take(self, sock: socket.socket | None) -> None:
        if sock is not None:
            sock.setblocking(False)
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket = sock

    def _drop(self) -> None:
        self._waiting.clear()
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def _call(address: tuple[str, int]) -> socket.socket:
    """Begin a connection without waiting for it; it shows later whether it came about."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    sock.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        sock.connect(address)
    return sock


def _accept(listener: socket.socket) -> socket.socket | None:
    try:
        return listener.accept()[0]
    except BlockingIOError:
        return None
