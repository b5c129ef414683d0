"""MAVLink over a serial line: a flight controller's UART or USB port."""

from __future__ import annotations

import fcntl
import os
import termios
import tty

from follower_vision.clock import Clock, MonotonicClock

_CHUNK = 65536
_MOST_WAITING = 8192
_RETRY_S = 1.0
_CFLAG, _ISPEED, _OSPEED = 2, 4, 5


class SerialTransport:
    """One serial port, raw, eight bits, no parity, one stop bit, never blocking; a `Transport`.

    A port that goes away (a USB plug that was pulled) is looked for again once a second. When the
    line is slower than what is sent, whole packets are dropped.

    Args:
        device: the port's file, e.g. /dev/ttyACM0.
        baud: bits a second, one of the rates that the system knows.
        clock: paces the looking for a port that has gone.

    Raises:
        OSError: there is no such port, it may not be used, or another program uses it.
        ValueError: the system does not know the baud rate.
    """

    def __init__(self, device: str, baud: int, clock: Clock | None = None) -> None:
        self._device = device
        self._speed = _speed(baud)
        self._clock = clock or MonotonicClock()
        self._tried_s = self._clock.now()
        self._waiting = bytearray()
        self._file: int | None = self._open()

    def send(self, data: bytes) -> None:
        """Send one packet, or drop it whole."""
        if self._file is not None and len(self._waiting) + len(data) <= _MOST_WAITING:
            self._waiting += data
            self._flush()

    def receive(self) -> bytes:
        """Return everything that has arrived."""
        if self._file is None:
            self._reopen()
        self._flush()
        if self._file is None:
            return b""
        try:
            return os.read(self._file, _CHUNK)
        except BlockingIOError:
            return b""
        except OSError:
            self._drop()
            return b""

    def close(self) -> None:
        """Give the port back."""
        self._drop()

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

    def _open(self) -> int:
        file = os.open(self._device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            fcntl.ioctl(file, termios.TIOCEXCL)
            tty.setraw(file)
            attributes = termios.tcgetattr(file)
            attributes[_CFLAG] |= termios.CLOCAL | termios.CREAD
            attributes[_ISPEED] = attributes[_OSPEED] = self._speed
            termios.tcsetattr(file, termios.TCSANOW, attributes)
            termios.tcflush(file, termios.TCIOFLUSH)
        except (OSError, termios.error) as error:
            os.close(file)
            raise OSError(error.args[0], error.args[-1]) from error
        return file

    def _reopen(self) -> None:
        now_s = self._clock.now()
        if now_s - self._tried_s < _RETRY_S:
            return
        self._tried_s = now_s
        try:
            self._file = self._open()
        except OSError:
            self._file = None

    def _drop(self) -> None:
        self._waiting.clear()
        if self._file is not None:
            os.close(self._file)
            self._file = None


def _speed(baud: int) -> int:
    speed = getattr(termios, f"B{baud}", None)
    if speed is None:
        known = sorted(int(name[1:]) for name in dir(termios) if name[1:].isdigit())
        usual = ", ".join(str(rate) for rate in known if rate >= 9600)
        raise ValueError(f"{baud} is no baud rate that this system knows: {usual}")
    return int(speed)
