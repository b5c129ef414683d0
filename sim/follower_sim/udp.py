"""The simulated autopilot's UDP port."""

from __future__ import annotations

import socket

from follower_control.udp import UdpTransport


def open_autopilot_port(host: str, port: int, local_port: int = 0) -> UdpTransport:
    """Speak first to a companion at `host`:`port`, as PX4's SITL does to 127.0.0.1:14540.

    Args:
        host: the companion's address.
        port: the companion's port.
        local_port: the autopilot's own, 0 for any free one.

    Raises:
        OSError: the host is not known, or the autopilot's port is in use; the message says which.
    """
    peer = (socket.gethostbyname(host), port)
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.bind(("", local_port))
    except OSError as error:
        sock.close()
        reason = error.strerror or str(error)
        text = f"the simulated autopilot cannot use UDP port {local_port}: {reason}"
        raise OSError(error.errno, text) from error
    return UdpTransport(sock, peer)
