"""A small RTSP server (RFC 2326) for one live stream and several viewers."""

import asyncio
import re
import secrets
import socket
import struct
from collections.abc import Callable
from contextlib import suppress

from follower.settings.ui import Address
from follower.ui.video.channel import SEND_BUFFER_BYTES, VideoChannel
from follower.ui.video.h264_encoder import AccessUnit
from follower.ui.video.rtp import RtpPacketiser, session_description

_METHODS = "OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN, GET_PARAMETER, SET_PARAMETER"
_MOST_HEADERS = 40
_MOST_BODY_BYTES = 4096
_IDLE_S = 120.0
_BEGINS_WITHIN_S = 10.0
"""A viewer that does not play after so long is disconnected; likewise one that reads nothing."""
_LONGEST_LINE_BYTES = 2048
_BEHIND_BYTES = 400_000
"""A viewer by TCP that is so far behind gets nothing more until the next key picture."""
_FIRST_PICTURE_S = 3.0

Headers = dict[str, str]


class RtspViewer:
    """Answers one connection until it ends, and sends it the stream."""

    def __init__(
        self, channel: VideoChannel, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        self._channel = channel
        self._reader = reader
        self._writer = writer
        self._loop = asyncio.get_running_loop()
        self._packetiser = RtpPacketiser(secrets.randbits(32), secrets.randbits(16))
        self._session = secrets.token_hex(8)
        self._udp: socket.socket | None = None
        self._is_set_up = False
        self._playing = False
        self._needs_key = True
        self._behind_s: float | None = None
        self._leave: Callable[[], None] | None = None
        self._keyed = asyncio.Event()

    async def run(self) -> None:
        """Answer until the viewer leaves or sends an invalid request."""
        watch = self._loop.call_later(_BEGINS_WITHIN_S, self._give_up)
        try:
            while (request := await self._request()) is not None:
                method, url, headers = request
                self._writer.write(await self._answer(method, url, headers))
                async with asyncio.timeout(_IDLE_S):
                    await self._writer.drain()
                if method == "TEARDOWN":
                    return
        finally:
            watch.cancel()

    def _give_up(self) -> None:
        if not self._playing:
            self._writer.transport.abort()

    def close(self) -> None:
        """Send no more."""
        self._playing = False
        if self._leave is not None:
            self._leave()
        if self._udp is not None:
            self._udp.close()
        self._writer.close()

    async def _request(self) -> tuple[str, str, Headers] | None:
        """Return the next request's method, address and headers; None at its end."""
        line = await self._line()
        if line is None:
            return None
        words = line.split()
        headers: Headers = {}
        for _ in range(_MOST_HEADERS):
            line = await self._line()
            if not line:
                break
            name, _, value = line.partition(":")
            headers[name.strip().lower()] = value.strip()
        if len(words) != 3 or not words[2].startswith("RTSP/"):
            return None
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > _MOST_BODY_BYTES:
            return None
        async with asyncio.timeout(_IDLE_S):
            await self._reader.readexactly(int(length))
        return words[0], words[1], headers

    async def _line(self) -> str | None:
        """Return the next line, leaving out RTCP that comes between; None at the end."""
        limit = None if self._playing and self._udp is None else _IDLE_S
        async with asyncio.timeout(limit):
            first = await self._reader.read(1)
            while first == b"$":
                _, length = struct.unpack("!BH", await self._reader.readexactly(3))
                await self._reader.readexactly(length)
                first = await self._reader.read(1)
            try:
                rest = b"" if first in (b"", b"\n") else await self._reader.readuntil(b"\n")
            except asyncio.LimitOverrunError:
                return None
        if not first or len(rest) > _LONGEST_LINE_BYTES:
            return None
        return (first + rest).decode("utf-8", "replace").strip()

    async def _answer(self, method: str, url: str, headers: Headers) -> bytes:
        number = headers.get("cseq", "0")
        if not number.isdecimal():
            return _response(400, "Bad Request", "0")
        if method == "OPTIONS":
            return _response(200, "OK", number, f"Public: {_METHODS}")
        if method == "DESCRIBE":
            return await self._describe(url, number)
        if method == "SETUP":
            return self._set_up(headers.get("transport", ""), number)
        if method == "PLAY":
            return self._play(number)
        if method in ("TEARDOWN", "GET_PARAMETER", "SET_PARAMETER"):
            return _response(200, "OK", number, f"Session: {self._session}")
        return _response(501, "Not Implemented", number)

    async def _describe(self, url: str, number: str) -> bytes:
        self._watch()
        with suppress(TimeoutError):  # the description then goes without parameter sets
            async with asyncio.timeout(_FIRST_PICTURE_S):
                await self._keyed.wait()
        body = session_description(self._channel.key_unit)
        base = url.rstrip("/")
        lines = (f"Content-Base: {base}/", "Content-Type: application/sdp")
        return _response(200, "OK", number, *lines, body=body)

    def _set_up(self, transport: str, number: str) -> bytes:
        offer = transport.split(",")[0].replace(" ", "")
        if "RTP/AVP/TCP" in offer:
            agreed = "RTP/AVP/TCP;unicast;interleaved=0-1"
        elif (ports := re.search(r"client_port=(\d{1,5})", offer)) and 0 < int(ports[1]) < 65535:
            agreed = self._open_udp(int(ports[1]))
        else:
            return _response(461, "Unsupported Transport", number)
        self._is_set_up = True
        session = f"Session: {self._session};timeout={int(_IDLE_S)}"
        return _response(200, "OK", number, f"Transport: {agreed}", session)

    def _open_udp(self, port: int) -> str:
        """Send to the asking computer alone, whatever it names as destination."""
        peer = self._writer.get_extra_info("peername")
        family = socket.AF_INET6 if ":" in peer[0] else socket.AF_INET
        if self._udp is not None:
            self._udp.close()
        self._udp = socket.socket(family, socket.SOCK_DGRAM)
        self._udp.setblocking(False)
        self._udp.connect((peer[0], port))
        ours = self._udp.getsockname()[1]
        return f"RTP/AVP;unicast;client_port={port}-{port + 1};server_port={ours}-{ours + 1}"

    def _play(self, number: str) -> bytes:
        if not self._is_set_up:
            return _response(455, "Method Not Valid in This State", number)
        self._watch()
        self._playing = self._needs_key = True
        self._channel.ask_for_key()
        return _response(200, "OK", number, f"Session: {self._session}", "Range: npt=0.000-")

    def _watch(self) -> None:
        if self._leave is None:
            self._leave = self._channel.watch(self._hand_over)

    def _hand_over(self, unit: AccessUnit) -> None:
        """Take a picture on the encoder's thread."""
        with suppress(RuntimeError):  # the loop was closed meanwhile
            self._loop.call_soon_threadsafe(self._send, unit)

    def _send(self, unit: AccessUnit) -> None:
        if unit.is_key:
            self._keyed.set()
        if not self._playing or self._writer.is_closing():
            return
        behind = self._is_behind()
        self._needs_key = (self._needs_key and not unit.is_key) or behind
        if self._needs_key:
            return
        for packet in self._packetiser.pack(unit):
            self._send_packet(packet)

    def _is_behind(self) -> bool:
        """Whether too much waits to be taken; for too long, it ends."""
        if self._writer.transport.get_write_buffer_size() <= _BEHIND_BYTES:
            self._behind_s = None
            return False
        now_s = self._loop.time()
        self._behind_s = now_s if self._behind_s is None else self._behind_s
        if now_s - self._behind_s > _BEGINS_WITHIN_S:
            self._writer.transport.abort()
        return True

    def _send_packet(self, packet: bytes) -> None:
        if self._udp is None:
            self._writer.write(struct.pack("!cBH", b"$", 0, len(packet)) + packet)
            return
        with suppress(OSError):  # the viewer's port is closed, or the network is gone for now
            self._udp.send(packet)


def _response(code: int, words: str, number: str, *lines: str, body: str = "") -> bytes:
    head = [f"RTSP/1.0 {code} {words}", f"CSeq: {number}", *lines]
    if body:
        head.append(f"Content-Length: {len(body)}")
    return ("\r\n".join([*head, "", ""]) + body).encode()


_MOST_VIEWERS, _MOST_OF_ONE_ADDRESS = 8, 4


class RtspServer:
    """Serves rtsp://host:port/live, with RTP inside the connection or by UDP.

    One address has at most half of the places; a viewer that does not play soon loses its own.

    Args:
        channel: what is shown.
        address: to listen at; port 0 takes a free one.

    Attributes:
        port: that it listens at, once started.
    """

    def __init__(self, channel: VideoChannel, address: Address) -> None:
        self._channel = channel
        self._address = address
        self._server: asyncio.Server | None = None
        self._viewers: dict[asyncio.Task[None], str] = {}
        self.port = address.port

    async def start(self) -> None:
        """Begin to listen.

        Raises:
            OSError: the address is taken or not ours.
        """
        self._server = await asyncio.start_server(
            self._serve, self._address.host, self._address.port
        )
        for listener in self._server.sockets:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        self.port = self._server.sockets[0].getsockname()[1]

    async def close(self) -> None:
        """Listen no more, and leave every viewer."""
        if self._server is not None:
            self._server.close()
        for task in self._viewers:
            task.cancel()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task, peer = asyncio.current_task(), writer.get_extra_info("peername")
        address = str(peer[0]) if peer else ""
        if task is None or not self._has_place_for(address):
            writer.close()
            return
        self._viewers[task] = address
        viewer = RtspViewer(self._channel, reader, writer)
        try:
            with suppress(OSError, EOFError, asyncio.CancelledError):
                await viewer.run()
        finally:
            del self._viewers[task]
            viewer.close()

    def _has_place_for(self, address: str) -> bool:
        of_one = sum(other == address for other in self._viewers.values())
        return len(self._viewers) < _MOST_VIEWERS and of_one < _MOST_OF_ONE_ADDRESS
