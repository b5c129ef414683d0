"""Connection strings, as users of pymavlink know them."""

from __future__ import annotations

from follower_control.transport import Transport
from follower_control.udp import UdpTransport


class ConnectionFailedError(ValueError):
    """The connection cannot be opened; the message says which, why and what to do."""


def open_connection(text: str) -> Transport:
    """Open `udpin:HOST:PORT` (wait to be spoken to) or `udpout:HOST:PORT` (speak first).

    Raises:
        ConnectionFailedError: the text is no such string, or the port cannot be opened.
    """
    kind, _, address = text.partition(":")
    host, _, port_text = address.rpartition(":")
    if kind not in ("udpin", "udp", "udpout") or not host or not port_text.isdigit():
        raise ConnectionFailedError(
            f"{text!r} is no connection: write udpin:HOST:PORT or udpout:HOST:PORT, "
            "for example udpin:0.0.0.0:14540"
        )
    port = int(port_text)
    if not 0 < port < 65536:
        raise ConnectionFailedError(f"{text!r}: a port lies between 1 and 65535")
    try:
        if kind == "udpout":
            return UdpTransport.connect(host, port)
        return UdpTransport.listen(host, port)
    except OSError as error:
        raise ConnectionFailedError(
            f"cannot open {text}: {error.strerror or error}; "
            "stop the program that uses the port, or choose another one with --connect"
        ) from error
