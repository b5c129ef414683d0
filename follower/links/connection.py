"""Connection strings, as users of pymavlink know them."""

from __future__ import annotations

import contextlib
import errno
import grp
import re
import socket
from collections.abc import Callable
from pathlib import Path

from follower.links.serial_port import SerialTransport
from follower.links.tcp import TcpTransport
from follower_control.transport import Transport
from follower_control.udp import UdpTransport

_BAUD = 115_200
_EXAMPLES = (
    "write udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or DEVICE:BAUD, "
    "for example udpin:0.0.0.0:14540 or /dev/ttyACM0:57600"
)
_NETWORK = re.compile(r"(udpin|udpout|udp|tcpin|tcp):([^:/\s]+):(\d+)")
_SERIAL = re.compile(r"(?:serial:)?(/[^:,\s]+)(?:[:,](\d+))?")


class ConnectionFailedError(ValueError):
    """The connection cannot be opened; the message says which, why and what to do."""


def open_connection(text: str) -> Transport:
    """Open what a connection string names.

    `udpin:` (also `udp:`) and `tcpin:` wait to be spoken to, `udpout:` and `tcp:` speak first.
    `/dev/ttyACM0:57600`, also with a comma or with `serial:` before it, is a serial port; without
    a baud rate it runs at 115200.

    Raises:
        ConnectionFailedError: the text is no such string, or it cannot be opened.
    """
    if match := _NETWORK.fullmatch(text):
        return _open_network(text, match[1], match[2], int(match[3]))
    if match := _SERIAL.fullmatch(text):
        return _open_serial(match[1], int(match[2] or _BAUD))
    raise ConnectionFailedError(f"{text!r} is no connection: {_EXAMPLES}")


def _open_network(text: str, kind: str, host: str, port: int) -> Transport:
    if not 0 < port < 65536:
        raise ConnectionFailedError(f"{text!r}: a port lies between 1 and 65535")
    openers: dict[str, Callable[[str, int], Transport]] = {
        "udpin": UdpTransport.listen,
        "udp": UdpTransport.listen,
        "udpout": UdpTransport.connect,
        "tcp": TcpTransport.connect,
        "tcpin": TcpTransport.listen,
    }
    try:
        return openers[kind](host, port)
    except OSError as error:
        raise ConnectionFailedError(_network_failure(text, host, port, error)) from error


def _network_failure(text: str, host: str, port: int, error: OSError) -> str:
    reason = error.strerror or str(error)
    if isinstance(error, socket.gaierror):
        return f"cannot open {text}: the name {host!r} is not known ({reason})"
    advice = {
        errno.EADDRINUSE: "stop the program that uses the port, or choose another one with "
        "--connect",
        errno.EADDRNOTAVAIL: f"{host} is not this machine's address; 0.0.0.0 means all of them",
        errno.ECONNREFUSED: f"nobody listens on port {port} of {host}: start the autopilot first",
        errno.EACCES: "ports below 1024 belong to the system: choose a higher one",
    }
    if isinstance(error, TimeoutError):
        return f"cannot open {text}: {host} does not answer"
    also = advice.get(error.errno or 0)
    return f"cannot open {text}: {reason}" + (f"; {also}" if also else "")


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
        errno.EACCES: f"you may not use it; {_permission_advice(device)}",
        errno.EBUSY: "another program uses it (ModemManager, mavlink-router, a ground station)",
        errno.ENOTTY: "it is no serial port",
    }
    also = advice.get(error.errno or 0)
    reason = error.strerror or str(error)
    return f"cannot open {device}: {reason}" + (f"; {also}" if also else "")


def _permission_advice(device: str) -> str:
    group = "dialout"
    with contextlib.suppress(OSError, KeyError):
        owner = grp.getgrgid(Path(device).stat().st_gid).gr_name
        group = group if owner == "root" else owner
    return f"join the group {group}: sudo usermod -aG {group} $USER, then log in again"
