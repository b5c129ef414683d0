"""Connection strings, as users of pymavlink know them."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import grp
import math
import os
import re
import socket
import sys
import termios
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import cast

from follower_control.common.transport import MOST_BYTES, Transport, UdpTransport
from follower_vision.clock import Clock, MonotonicClock

_CHUNK = 4096
_MOST_WAITING, _LONGEST_WAIT_S = 8192, 0.1
_BITS_A_BYTE = 10
_RETRY_S = 1.0
_CONNECT_S = 3.0
_SILENT_S = 3.0
"""An autopilot sends a heartbeat each second."""
_IFLAG, _OFLAG, _CFLAG, _LFLAG, _ISPEED, _OSPEED, _CC = range(7)
_NOT_WANTED = termios.CSIZE | termios.CSTOPB | termios.PARENB | termios.CRTSCTS
_BAUD = 115_200
_EXAMPLES = (
    "write udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or DEVICE:BAUD, "
    "for example udpin:0.0.0.0:14540 or /dev/ttyACM0:57600"
)
_NETWORK = re.compile(r"(udpin|udpout|udp|tcpin|tcp):([^:/\s]+):(\d+)")
_SERIAL = re.compile(r"(?:serial:)?(/[^:,\s]+)(?:[:,](\d+))?")


class ConnectionFailedError(ValueError):
    """The connection cannot be opened; the message says which, why and what to do.

    Examples:
        >>> import follower
        >>> try:
        ...     with follower.Pursuit("udpin:0.0.0.0:1x", camera=0):
        ...         pass
        ... except follower.ConnectionFailedError as error:
        ...     print(error)
        'udpin:0.0.0.0:1x' is no connection: ...
    """


class _StreamTransport:
    """A stream of bytes that never blocks and is opened again when it breaks; a `Transport`.

    While it is broken what is sent is lost, as with UDP. Where the other end or the line is too
    slow, whole packets are dropped, not parts: what waits for long is an old setpoint.

    Args:
        reopen: opens the stream and returns its file descriptor, or raises OSError.
        file: the descriptor, if it is open already.
        retry_s: seconds between two attempts to open it.
        clock: paces the attempts.
        rate: bytes a second that the line carries; None where nobody knows.
    """

    def __init__(
        self,
        reopen: Callable[[], int],
        file: int | None,
        retry_s: float,
        clock: Clock | None,
        rate: float | None = None,
    ) -> None:
        self._reopen = reopen
        self._file = file
        self._rate = rate
        self._all_left_s = -math.inf
        self._retry_s = retry_s
        self._clock = clock or MonotonicClock()
        self._tried_s = self._clock.now()
        self._waiting = bytearray()

    def send(self, data: bytes) -> None:
        """Send one packet, or drop it whole."""
        if self._file is None:
            return
        self._flush()
        if self._has_room(len(data)):
            self._waiting += data
            self._flush()

    def receive(self) -> bytes:
        """Return what has arrived, of a flood the oldest part."""
        now_s = self._clock.now()
        if self._file is None and now_s - self._tried_s >= self._retry_s:
            self._tried_s = now_s
            with contextlib.suppress(OSError):
                self._file = self._reopen()
        self._flush()
        parts: list[bytes] = []
        while self._file is not None and len(parts) * _CHUNK < MOST_BYTES:
            try:
                data = os.read(self._file, _CHUNK)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            if not data:
                self._drop()
            parts.append(data)
        return b"".join(parts)

    def close(self) -> None:
        """Close the stream."""
        self._drop()

    def _has_room(self, size: int) -> bool:
        """Whether a packet would leave soon.

        The system alone keeps a second of a slow line, and megabytes for a TCP peer out of reach.
        """
        queued = self._queued
        if self._rate is None:
            return queued + size <= _MOST_WAITING
        if len(self._waiting) + size > _MOST_WAITING:
            return False
        now_s = self._clock.now()
        # USB counts too many bytes as waiting, but none where all have left.
        begins_s = max(self._all_left_s, now_s) if queued else now_s
        if begins_s - now_s > _LONGEST_WAIT_S:
            return False
        self._all_left_s = begins_s + size / self._rate
        return True

    @property
    def _queued(self) -> int:
        """How many bytes were sent and have not left yet, here or in the system; over TCP: come."""
        if self._file is None:
            return len(self._waiting)
        try:
            kept = fcntl.ioctl(self._file, termios.TIOCOUTQ, bytes(4))
        except OSError:  # a driver that does not tell
            kept = b"\1"
        return len(self._waiting) + int.from_bytes(kept, sys.byteorder)

    def _flush(self) -> None:
        if self._file is None or not self._waiting:
            return
        try:
            sent = os.write(self._file, self._waiting)
            del self._waiting[:sent]
        except BlockingIOError:
            return
        except OSError:
            self._drop()

    def _drop(self) -> None:
        self._waiting.clear()
        if self._file is not None:
            os.close(self._file)
            self._file = None


class SerialTransport(_StreamTransport):
    """One serial port, raw, eight bits, no parity, one stop bit, no flow control, never blocking.

    It is so whatever another program has left: the system keeps a port's settings. A port that
    goes away (a USB plug that was pulled) is opened again once it is back. A `Transport`.

    Args:
        device: the port's file, e.g. /dev/ttyACM0.
        baud: bits a second, one of the rates that the system knows.
        clock: paces the attempts to open a port that has gone.

    Raises:
        OSError: there is no such port, it may not be used, or another program uses it.
        ValueError: the system does not know the baud rate.
    """

    def __init__(self, device: str, baud: int, clock: Clock | None = None) -> None:
        reopen = partial(_serial_port, device, _speed(baud))
        super().__init__(reopen, reopen(), _RETRY_S, clock, baud / _BITS_A_BYTE)


def _serial_port(device: str, speed: int) -> int:
    file = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        fcntl.ioctl(file, termios.TIOCEXCL)
        attributes = termios.tcgetattr(file)
        attributes[_IFLAG] = attributes[_OFLAG] = attributes[_LFLAG] = 0
        attributes[_CFLAG] &= ~_NOT_WANTED
        attributes[_CFLAG] |= termios.CS8 | termios.CLOCAL | termios.CREAD
        attributes[_ISPEED] = attributes[_OSPEED] = speed
        attributes[_CC][termios.VMIN], attributes[_CC][termios.VTIME] = 1, 0
        termios.tcsetattr(file, termios.TCSANOW, attributes)
        termios.tcflush(file, termios.TCIOFLUSH)
    except (OSError, termios.error) as error:
        os.close(file)
        raise OSError(error.args[0], error.args[-1]) from error
    return file


def _speed(baud: int) -> int:
    speed = getattr(termios, f"B{baud}", 0)
    if not speed:  # B0 hangs up
        known = sorted(int(name[1:]) for name in dir(termios) if name[1:].isdigit())
        usual = ", ".join(str(rate) for rate in known if rate >= 9600)
        raise ValueError(f"{baud} is no baud rate that this system knows: {usual}")
    return int(speed)


class TcpTransport(_StreamTransport):
    """One peer over TCP, never blocking once it is open; a `Transport`.

    Make one by `connect` (it calls) or `listen` (it is called; one peer at a time). A connection on
    which nothing that was sent has arrived for 3 s is broken. Who calls takes the place of a peer
    that is silent: a program may hang whose system takes all that comes.
    """

    _listener: socket.socket | None = None
    _heard_s = -math.inf

    @classmethod
    def connect(cls, host: str, port: int, clock: Clock | None = None) -> TcpTransport:
        """Call a listening peer, and again once a second after the connection broke.

        Raises:
            OSError: the name is not known, or nobody listens there.
        """
        address = socket.gethostbyname(host), port
        file = _stream(socket.create_connection(address, _CONNECT_S))
        return cls(partial(_call, address), file, _RETRY_S, clock)

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
        transport = cls(lambda: _stream(listener.accept()[0]), None, 0.0, clock)
        transport._listener = listener
        return transport

    @property
    def port(self) -> int:
        """The port on which it listens, 0 if it does not."""
        return 0 if self._listener is None else int(self._listener.getsockname()[1])

    def receive(self) -> bytes:
        """Return what has arrived, of a flood the oldest part."""
        data, now_s = super().receive(), self._clock.now()
        if data or self._file is None:
            self._heard_s = now_s
        elif self._listener is not None and now_s - self._heard_s > _SILENT_S:
            with contextlib.suppress(OSError):  # nobody calls
                caller = self._reopen()
                self._drop()
                self._file, self._heard_s = caller, now_s
        return data

    def close(self) -> None:
        """Close the connection, and listen no longer."""
        super().close()
        if self._listener is not None:
            self._listener.close()


def _call(address: tuple[str, int]) -> int:
    """Begin a connection without waiting for it; it shows later whether it came about."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    _set(sock)
    with contextlib.suppress(BlockingIOError):
        sock.connect(address)
    return sock.detach()


def _stream(sock: socket.socket) -> int:
    """Return a socket as a file descriptor that does not block."""
    _set(sock)
    return sock.detach()


def _set(sock: socket.socket) -> None:
    sock.setblocking(False)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    # The system tries less and less often: after a gap of 20 s it may let pass as much again.
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(1e3 * _SILENT_S))


def check_connection(text: str) -> None:
    """Make sure that a text is a connection string, without opening it.

    Raises:
        ConnectionFailedError: it is none.
    """
    network = _NETWORK.fullmatch(text)
    if network is None and not _SERIAL.fullmatch(text):
        raise ConnectionFailedError(f"{text!r} is no connection: {_EXAMPLES}")
    if network is not None and not 0 < int(network[3]) < 65536:
        raise ConnectionFailedError(f"{text!r}: a port lies between 1 and 65535")


def open_connection(text: str) -> Transport:
    """Open what a connection string names.

    `udpin:` (also `udp:`) and `tcpin:` wait to be spoken to, `udpout:` and `tcp:` speak first.
    `/dev/ttyACM0:57600`, also with a comma or with `serial:` before it, is a serial port; without
    a baud rate it runs at 115200.

    Raises:
        ConnectionFailedError: the text is no such string, or it cannot be opened.
    """
    check_connection(text)
    if match := _NETWORK.fullmatch(text):
        return _open_network(text, match[1], match[2], int(match[3]))
    serial = cast(re.Match[str], _SERIAL.fullmatch(text))
    return _open_serial(serial[1], int(serial[2] or _BAUD))


def _open_network(text: str, kind: str, host: str, port: int) -> Transport:
    openers: dict[str, Callable[[str, int], Transport]] = {
        "udpin": UdpTransport.listen,
        "udp": UdpTransport.listen,
        "udpout": UdpTransport.connect,
        "tcp": TcpTransport.connect,
        "tcpin": TcpTransport.listen,
    }
    try:
        return openers[kind](host, port)
    except (OSError, UnicodeError) as error:
        raise ConnectionFailedError(_network_failure(text, host, port, error)) from error


def _network_failure(text: str, host: str, port: int, error: OSError | UnicodeError) -> str:
    if isinstance(error, UnicodeError):
        return f"cannot open {text}: {host!r} is no name that a computer can have"
    if isinstance(error, socket.gaierror):
        return f"cannot open {text}: the name {host!r} is not known ({error.strerror or error})"
    advice = {
        errno.EADDRINUSE: "stop the program that uses the port, or choose another one with "
        "--connect",
        errno.EADDRNOTAVAIL: f"{host} is not this machine's address; 0.0.0.0 means all of them",
        errno.ECONNREFUSED: f"nobody listens on port {port} of {host}: start the autopilot first",
        errno.EACCES: "ports below 1024 belong to the system: choose a higher one",
    }
    if isinstance(error, TimeoutError):
        return f"cannot open {text}: {host} does not answer"
    return _failure(text, error, advice)


def _open_serial(device: str, baud: int) -> Transport:
    try:
        return SerialTransport(device, baud)
    except ValueError as error:
        raise ConnectionFailedError(f"cannot open {device}: {error}") from error
    except OSError as error:
        raise ConnectionFailedError(_serial_failure(device, error)) from error


def _serial_failure(device: str, error: OSError) -> str:
    advice = {
        errno.ENOENT: "is it plugged in? `ls -l /dev/serial/by-id` names those that are",
        errno.EACCES: f"you may not use it; {permission_advice(device)}",
        errno.EBUSY: "another program uses it (ModemManager, mavlink-router, a ground station)",
        errno.ENOTTY: "it is no serial port",
    }
    return _failure(device, error, advice)


def _failure(named: str, error: OSError, advice: Mapping[int, str]) -> str:
    also = advice.get(error.errno or 0)
    return f"cannot open {named}: {error.strerror or error}" + (f"; {also}" if also else "")


def permission_advice(device: str) -> str:
    """Return how to get the right to use a device's file."""
    group = "dialout"
    with contextlib.suppress(OSError, KeyError):
        owner = grp.getgrgid(Path(device).stat().st_gid).gr_name
        group = group if owner == "root" else owner
    return f"join the group {group}: sudo usermod -aG {group} $USER, then log in again"
