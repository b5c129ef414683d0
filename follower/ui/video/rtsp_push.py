"""Pushes the stream to an RTSP server that others watch (RFC 2326: ANNOUNCE and RECORD, by TCP)."""

from __future__ import annotations

import contextlib
import re
import secrets
import socket
import struct
import threading
from collections.abc import Callable
from urllib.parse import urlsplit

from follower.ui.video.h264_encoder import AccessUnit
from follower.ui.video.rtp import RtpPacketiser, session_description
from follower_vision.mailbox import Mailbox
from follower_vision.sources.frame_source import ClosesItself

_PORT = 554
_RETRY_S = 2.0
_PATIENCE_S = 0.5
_TIMEOUT_S = 3.0
_MOST_ANSWER_BYTES = 16_384


class PushError(OSError):
    """The server does not take the stream."""


class RtspPush(ClosesItself):
    """Sends each picture on its own thread; while the server does not take them they are left out.

    After a gap it begins again with a key picture. A server that is gone is tried again. ffmpeg is
    not used for this: it would hold up every other thread while it waits for the server.

    Args:
        url: rtsp://server:port/name.
        say: takes a line, on this one's thread, when the server does not take the stream, and why.

    Attributes:
        problem: why nothing is sent now, None while it is.
    """

    def __init__(self, url: str, say: Callable[[str], None] | None = None) -> None:
        self._url = url
        self._say = say
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
        self._thread.join(2 * _TIMEOUT_S)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self._send_all()
            except OSError as error:
                self._tell(f"{self._url}: {error.strerror or error}")
                self._stop.wait(_RETRY_S)

    def _tell(self, problem: str) -> None:
        """Say a problem once, however often it comes."""
        before, self.problem = self.problem, problem
        if self._say is not None and problem != before:
            self._say(f"Video is not pushed: {problem}; it is tried again")

    def _send_all(self) -> None:
        first = self._next_key()
        if first is None:
            return
        with _Session(self._url, session_description(first)) as session:
            self.problem = None
            lost, needs_key = self._units.overwritten, True
            while not self._stop.is_set():
                unit = self._units.wait(_PATIENCE_S)
                needs_key = needs_key or self._units.overwritten > lost
                lost = self._units.overwritten
                if unit is not None and (unit.is_key or not needs_key):
                    needs_key = False
                    session.send(unit)

    def _next_key(self) -> AccessUnit | None:
        """Wait for a key picture, whose parameter sets the server needs; None at the end."""
        while not self._stop.is_set():
            unit = self._units.wait(_PATIENCE_S)
            if unit is not None and unit.is_key:
                return unit
        return None


class _Session:
    """One connection to the server, from ANNOUNCE to TEARDOWN."""

    def __init__(self, url: str, description: str) -> None:
        parts = urlsplit(url)
        self._url = url
        self._number = 0
        self._session = ""
        self._packetiser = RtpPacketiser(secrets.randbits(32), secrets.randbits(16))
        address = (parts.hostname or "", parts.port or _PORT)
        self._socket = socket.create_connection(address, _TIMEOUT_S)
        try:
            self._ask("ANNOUNCE", url, "Content-Type: application/sdp", body=description)
            transport = "Transport: RTP/AVP/TCP;unicast;interleaved=0-1;mode=record"
            answer = self._ask("SETUP", f"{url}/streamid=0", transport)
            found = re.search(r"(?im)^session: *([^;\s]+)", answer)
            self._session = found[1] if found else ""
            self._ask("RECORD", url, "Range: npt=0.000-")
        except OSError:
            self._socket.close()
            raise

    def __enter__(self) -> _Session:
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(OSError):
            self._ask("TEARDOWN", self._url)
        self._socket.close()

    def send(self, unit: AccessUnit) -> None:
        packets = self._packetiser.pack(unit)
        framed = [struct.pack("!cBH", b"$", 0, len(one)) + one for one in packets]
        self._socket.sendall(b"".join(framed))

    def _ask(self, method: str, url: str, *lines: str, body: str = "") -> str:
        self._number += 1
        head = [f"{method} {url} RTSP/1.0", f"CSeq: {self._number}", *lines]
        head += [f"Session: {self._session}"] if self._session else []
        head += [f"Content-Length: {len(body)}"] if body else []
        self._socket.sendall(("\r\n".join([*head, "", ""]) + body).encode())
        answer = self._answer()
        if not re.match(r"RTSP/1\.0 200 ", answer):
            words = answer.partition("\r\n")[0] or "nothing"
            raise PushError(f"the server answers {method} with {words}")
        return answer

    def _answer(self) -> str:
        answer = b""
        while b"\r\n\r\n" not in answer and len(answer) < _MOST_ANSWER_BYTES:
            part = self._socket.recv(4096)
            if not part:
                break
            answer += part
        return answer.decode("utf-8", "replace")
