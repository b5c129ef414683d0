"""RTP by UDP to one listener, as QGroundControl takes it at port 5600."""

from __future__ import annotations

import secrets
import socket
from contextlib import suppress
from typing import Any

from follower.video_out.encoder import AccessUnit
from follower.video_out.rtp import RtpPacketiser
from follower.video_out.settings import Address
from follower_vision.framesource import ClosesItself

_SEND_BUFFER_BYTES = 1 << 20


class RtpSender(ClosesItself):
    """Sends each picture at once; what the network does not take is left out.

    Args:
        address: of the listener. A name is looked up once.

    Raises:
        OSError: the name cannot be looked up.
    """

    def __init__(self, address: Address) -> None:
        found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)[0]
        family, kind, _, _, target = found
        self._target: tuple[Any, ...] = target
        self._socket = socket.socket(family, kind)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        self._packetiser = RtpPacketiser(secrets.randbits(32), secrets.randbits(16))

    def __call__(self, unit: AccessUnit) -> None:
        """Send a picture."""
        for packet in self._packetiser.pack(unit):
            with suppress(OSError):  # nobody listens, or the network is gone for now
                self._socket.sendto(packet, self._target)

    def close(self) -> None:
        """Send no more."""
        self._socket.close()
