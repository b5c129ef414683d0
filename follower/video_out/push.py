"""Pushes the stream to an RTSP server that others watch."""

from __future__ import annotations

import threading
from fractions import Fraction
from typing import Any

import av
import av.error
from av.stream import Stream

from follower.video_out.encoder import TICKS_PER_S, AccessUnit
from follower_vision.framesource import ClosesItself
from follower_vision.mailbox import Mailbox

_RETRY_S = 2.0
_PATIENCE_S = 0.5
_TIMEOUT_US = "3000000"
_FAILURES = (av.error.FFmpegError, OSError)


class RtspPush(ClosesItself):
    """Sends each picture on its own thread; while the server does not take them they are left out.

    After a gap it begins again with a key picture. A server that is gone is tried again.

    Args:
        url: rtsp://server:port/name.

    Attributes:
        problem: why nothing is sent now, None while it is.
    """

    def __init__(self, url: str) -> None:
        self._url = url
        self._units: Mailbox[AccessUnit] = Mailbox()
        self._stop = threading.Event()
        self.problem: str | None = None
        self._thread = threading.Thread(target=self._run, name="rtsp push", daemon=True)
        self._thread.start()

    def __call__(self, unit: AccessUnit) -> None:
        """Take a picture for sending; never waits."""
        self._units.put(unit)

    def close(self) -> None:
        """Send no more."""
        self._stop.set()
        self._units.close()
        self._thread.join(2.0)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self._send_all()
            except _FAILURES as error:
                self.problem = f"{self._url}: {getattr(error, 'strerror', None) or error}"
                self._stop.wait(_RETRY_S)

    def _send_all(self) -> None:
        options = {"rtsp_transport": "tcp", "timeout": _TIMEOUT_US}
        with av.open(self._url, "w", format="rtsp", options=options) as container:
            # The muxer insists on a size; viewers take it from the pictures themselves.
            stream = container.add_mux_stream("h264", width=640, height=480)
            container.start_encoding()
            self.problem = None
            overwritten, waits_for_key = self._units.overwritten, True
            while not self._stop.is_set():
                unit = self._units.wait(_PATIENCE_S)
                lost, overwritten = self._units.overwritten > overwritten, self._units.overwritten
                waits_for_key = waits_for_key or lost
                if unit is None or (waits_for_key and not unit.is_key):
                    continue
                waits_for_key = False
                container.mux(_packet(unit, stream))


def _packet(unit: AccessUnit, stream: Stream) -> av.Packet[Any]:
    packet: av.Packet[Any] = av.Packet(unit.data)
    packet.stream = stream
    packet.pts = packet.dts = unit.ticks
    packet.time_base = Fraction(1, TICKS_PER_S)
    packet.is_keyframe = unit.is_key
    return packet
