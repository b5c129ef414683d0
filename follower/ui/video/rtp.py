"""H.264 as RTP packets: RFC 6184, single NAL units and fragments (packetization-mode=1)."""

import base64
import secrets
import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from follower.settings.ui import Address
from follower.ui.video.h264_encoder import AccessUnit
from follower_vision.sources.frame_source import ClosesItself

PAYLOAD_TYPE = 96
_MOST_BYTES = 1200
"""Of one packet's payload; fits an Ethernet frame through any usual tunnel."""
_SPS, _PPS, _FU_A = 7, 8, 28
_SEND_BUFFER_BYTES = 1 << 20


def nal_units(data: bytes) -> list[bytes]:
    """Return the NAL units of an Annex B stream, without their start codes."""
    units = (part.rstrip(b"\x00") for part in data.split(b"\x00\x00\x01")[1:])
    return [unit for unit in units if unit]


class RtpPacketiser:
    """Numbers and cuts the packets of one stream.

    Args:
        ssrc: the stream's number; two streams of one session have different ones.
        sequence: of the first packet.
    """

    def __init__(self, ssrc: int, sequence: int = 0) -> None:
        self._ssrc = ssrc & 0xFFFFFFFF
        self._sequence = sequence

    def pack(self, unit: AccessUnit) -> list[bytes]:
        """Return an encoded picture as packets; the last one has the marker set."""
        payloads = [part for nal in nal_units(unit.data) for part in _payloads(nal)]
        last = len(payloads) - 1
        return [
            self._header(unit.ticks, marker=index == last) + payload
            for index, payload in enumerate(payloads)
        ]

    def _header(self, ticks: int, marker: bool) -> bytes:
        second = (0x80 if marker else 0) | PAYLOAD_TYPE
        sequence = self._sequence
        self._sequence = (sequence + 1) & 0xFFFF
        return struct.pack("!BBHII", 0x80, second, sequence, ticks & 0xFFFFFFFF, self._ssrc)


def _payloads(nal: bytes) -> Iterator[bytes]:
    """Return a NAL unit whole, or as FU-A fragments if it is too long for one packet."""
    if len(nal) <= _MOST_BYTES:
        yield nal
        return
    indicator = (nal[0] & 0xE0) | _FU_A
    kind, body, room = nal[0] & 0x1F, nal[1:], _MOST_BYTES - 2
    for start in range(0, len(body), room):
        first, last = start == 0, start + room >= len(body)
        header = (0x80 if first else 0) | (0x40 if last else 0) | kind
        yield bytes((indicator, header)) + body[start : start + room]


def session_description(unit: AccessUnit | None) -> str:
    """Return the stream's SDP.

    Args:
        unit: a key picture, whose parameter sets let a viewer set up its decoder early.
    """
    lines = (
        *("v=0", "o=- 0 0 IN IP4 127.0.0.1", "s=drone target follower", "c=IN IP4 0.0.0.0"),
        *("t=0 0", f"m=video 0 RTP/AVP {PAYLOAD_TYPE}", f"a=rtpmap:{PAYLOAD_TYPE} H264/90000"),
        f"a=fmtp:{PAYLOAD_TYPE} packetization-mode=1{_parameter_sets(unit)}",
        *("a=control:streamid=0", ""),
    )
    return "\r\n".join(lines)


def _parameter_sets(unit: AccessUnit | None) -> str:
    nals = [] if unit is None else nal_units(unit.data)
    sets = [nal for nal in nals if nal[0] & 0x1F in (_SPS, _PPS)]
    if len(sets) < 2:
        return ""
    encoded = ",".join(base64.b64encode(nal).decode() for nal in sets)
    return f";profile-level-id={sets[0][1:4].hex()};sprop-parameter-sets={encoded}"


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
