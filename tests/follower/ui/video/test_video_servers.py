"""Video by RTSP, UDP and pushed to a server."""

from __future__ import annotations

import asyncio
import contextlib
import re
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

import av
import cv2
import numpy as np
import pytest
from video_pictures import PATIENCE_S, SETTINGS, picture
from waiting import until

from follower.settings.ui import Address
from follower.ui.video.channel import Picture, VideoChannel
from follower.ui.video.rtp import RtpSender
from follower.ui.video.rtsp_push import RtspPush
from follower.ui.video.rtsp_server import RtspServer
from follower_vision.sources.capture import CaptureSettings
from follower_vision.sources.live_source import LiveSettings
from follower_vision.sources.open import open_source


class Live:
    """A channel that is shown pictures at thirty a second, and a loop for servers."""

    def __init__(self) -> None:
        self.channel = VideoChannel(SETTINGS, overlay=False)
        self.loop = asyncio.new_event_loop()
        self._stop = threading.Event()
        self._threads = [
            threading.Thread(target=self._show, daemon=True),
            threading.Thread(target=self.loop.run_forever, daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def serve(self) -> RtspServer:
        server = RtspServer(self.channel, Address("127.0.0.1", 0))
        asyncio.run_coroutine_threadsafe(server.start(), self.loop).result(PATIENCE_S)
        return server

    def close(self, server: RtspServer | None = None) -> None:
        if server is not None:
            asyncio.run_coroutine_threadsafe(server.close(), self.loop).result(PATIENCE_S)
            time.sleep(0.1)
        self._stop.set()
        self.loop.call_soon_threadsafe(self.loop.stop)
        for thread in self._threads:
            thread.join(PATIENCE_S)
        self.loop.close()

    def _show(self) -> None:
        number = 0
        while not self._stop.wait(1 / 30):
            self.channel.show(picture(number))
            number += 1


@pytest.fixture
def live() -> Iterator[Live]:
    live = Live()
    yield live
    live.close()


@pytest.fixture
def server() -> Iterator[tuple[Live, RtspServer]]:
    live = Live()
    server = live.serve()
    yield live, server
    live.close(server)


def bright_square(frame: av.VideoFrame) -> bool:
    grey = cv2.cvtColor(frame.to_ndarray(format="bgr24"), cv2.COLOR_BGR2GRAY)
    return bool(grey.max() > 190 and grey.min() < 90)


def watched(address: str, options: dict[str, str], count: int = 12) -> int:
    quick = {"probesize": "4096", "analyzeduration": "0", "fflags": "nobuffer", **options}
    with av.open(address, options=quick, timeout=PATIENCE_S) as container:
        frames = container.decode(video=0)
        return sum(bright_square(next(frames)) for _ in range(count))


@pytest.mark.slow
@pytest.mark.parametrize("way", ["tcp", "udp"])
def test_ffmpeg_plays_it_by_rtsp(server: tuple[Live, RtspServer], way: str) -> None:
    live, rtsp = server
    url = f"rtsp://127.0.0.1:{rtsp.port}/live"
    assert watched(url, {"rtsp_transport": way}) == 12
    until(lambda: not live.channel.watched)


@pytest.mark.slow
@pytest.mark.parametrize("way", ["tcp", "udp"])
def test_our_own_source_plays_it_and_connects_again_where_it_was_hung_up_on(
    server: tuple[Live, RtspServer], way: Literal["tcp", "udp"]
) -> None:
    live, rtsp = server
    quick = LiveSettings(first_frame_s=PATIENCE_S, retry_s=0.05, longest_retry_s=0.2)
    url, capture = f"rtsp://127.0.0.1:{rtsp.port}/live", CaptureSettings(transport=way)
    with open_source(url, live=quick, capture=capture) as source:
        frames = [source.read() for _ in range(15)]
        times_s = [frame.captured_s for frame in frames if frame is not None]
        assert len(times_s) == 15
        assert np.diff(times_s).min() > 0
        live.loop.call_soon_threadsafe(lambda: [task.cancel() for task in rtsp._viewers])
        until(lambda: source.connections == 2)
        again = source.read()
    assert again.sequence > 14


@pytest.mark.slow
def test_two_play_it_at_once_and_a_third_who_does_not_read_harms_neither(
    server: tuple[Live, RtspServer],
) -> None:
    live, rtsp = server
    url = f"rtsp://127.0.0.1:{rtsp.port}/live"
    stuck = ask(rtsp.port, "SETUP", "Transport: RTP/AVP/TCP;unicast;interleaved=0-1")
    stuck.sendall(request("PLAY"))
    with av.open(url, options={"rtsp_transport": "tcp"}, timeout=PATIENCE_S) as first:
        next(first.decode(video=0))
        assert watched(url, {"rtsp_transport": "tcp"}) == 12
        next(first.decode(video=0))
    stuck.close()
    until(lambda: not live.channel.watched)


@pytest.mark.slow
def test_udp_listeners_get_it_without_asking(
    live: Live, tmp_path: Path, free_port: Callable[[], int]
) -> None:
    port = free_port()
    sdp = tmp_path / "live.sdp"
    sdp.write_text(f"v=0\nc=IN IP4 127.0.0.1\nm=video {port} RTP/AVP 96\na=rtpmap:96 H264/90000\n")
    with RtpSender(Address("127.0.0.1", port)) as sender:
        leave = live.channel.watch(sender)
        assert watched(str(sdp), {"protocol_whitelist": "file,udp,rtp"}) == 12
        leave()


def request(method: str, *lines: str, number: int = 1) -> bytes:
    return "\r\n".join(
        [f"{method} rtsp://x/live RTSP/1.0", f"CSeq: {number}", *lines, "", ""]
    ).encode()


def ask(port: int, method: str, *lines: str) -> socket.socket:
    connection = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE_S)
    connection.sendall(request(method, *lines))
    return connection


@pytest.mark.parametrize(
    ("method", "lines", "code"),
    [
        ("OPTIONS", (), b"200"),
        ("PLAY", (), b"455"),
        ("SETUP", ("Transport: RAW/RAW/UDP",), b"461"),
        ("SETUP", ("Transport: RTP/AVP;unicast;client_port=99999-100000",), b"461"),
        ("SETUP", ("Transport: RTP/AVP;unicast;client_port=0-1",), b"461"),
        ("RECORD", (), b"501"),
        ("SETUP", ("Transport: RTP/AVP;unicast;destination=8.8.8.8;client_port=9-10",), b"200"),
    ],
)
def test_what_it_cannot_do_it_refuses_by_the_right_number(
    server: tuple[Live, RtspServer], method: str, lines: tuple[str, ...], code: bytes
) -> None:
    with ask(server[1].port, method, *lines) as connection:
        answer = connection.recv(4096)
    assert answer.split(b" ", 2)[1] == code
    assert b"8.8.8.8" not in answer


@pytest.mark.parametrize(
    "rude",
    [
        b"GET / HTTP/1.1\r\n\r\n",
        b"\x00" * 100 + b"\n\n",
        b"A" * 100_000 + b"\r\n\r\n",
        b"OPTIONS * RTSP/1.0\r\nContent-Length: 99999999\r\n\r\n",
        b"OPTIONS * RTSP/1.0\r\nCSeq: x\r\n\r\n",
        b"$\x00\xff\xff",
    ],
)
def test_nonsense_ends_the_connection_and_nothing_else(
    server: tuple[Live, RtspServer], rude: bytes
) -> None:
    one = socket.create_connection(("127.0.0.1", server[1].port), timeout=PATIENCE_S)
    with one, contextlib.suppress(ConnectionError):
        one.sendall(rude)
        one.shutdown(socket.SHUT_WR)
        assert b" 200 " not in one.recv(4096)
    with ask(server[1].port, "OPTIONS") as connection:
        assert b"200 OK" in connection.recv(4096)


@pytest.mark.parametrize(
    "unfinished",
    [
        b"OPTIONS * RTSP/1.0\r\nContent-Length: 4096\r\n\r\n",
        b"OPTIONS * RTSP/1.0\r\n",
        b"",
    ],
)
def test_who_says_nothing_more_gives_his_place_back(
    monkeypatch: pytest.MonkeyPatch, server: tuple[Live, RtspServer], unfinished: bytes
) -> None:
    monkeypatch.setattr("follower.ui.video.rtsp_server._IDLE_S", 0.2)
    with socket.create_connection(("127.0.0.1", server[1].port), timeout=PATIENCE_S) as one:
        one.sendall(unfinished)
        assert one.recv(4096) == b""


def is_hung_up_on(connection: socket.socket) -> bool:
    connection.settimeout(PATIENCE_S)
    try:
        while connection.recv(65536):
            pass
    except ConnectionResetError:
        return True
    return True


def test_one_address_does_not_take_all_places(server: tuple[Live, RtspServer]) -> None:
    where = ("127.0.0.1", server[1].port)
    with contextlib.ExitStack() as stack:
        for _ in range(4):
            one = stack.enter_context(ask(where[1], "OPTIONS"))
            assert b"200 OK" in one.recv(4096)
        with ask(where[1], "OPTIONS") as fifth:
            assert is_hung_up_on(fifth)
        other = socket.create_connection(where, PATIENCE_S, ("127.0.0.2", 0))
        with other:
            other.sendall(request("OPTIONS"))
            assert b"200 OK" in other.recv(4096)


@pytest.mark.parametrize("said", [(), ("OPTIONS",), ("DESCRIBE",)])
def test_who_does_not_play_soon_loses_his_place(
    monkeypatch: pytest.MonkeyPatch, server: tuple[Live, RtspServer], said: tuple[str, ...]
) -> None:
    monkeypatch.setattr("follower.ui.video.rtsp_server._BEGINS_WITHIN_S", 0.3)
    where = ("127.0.0.1", server[1].port)
    with socket.create_connection(where, timeout=PATIENCE_S) as one, ask(where[1], "SETUP") as two:
        for method in said:
            one.sendall(request(method))
        assert is_hung_up_on(one)
        assert is_hung_up_on(two)


def test_who_plays_and_takes_nothing_loses_his_place(
    monkeypatch: pytest.MonkeyPatch, server: tuple[Live, RtspServer]
) -> None:
    monkeypatch.setattr("follower.ui.video.rtsp_server._BEGINS_WITHIN_S", 0.3)
    nothing_is_little_enough = -1
    monkeypatch.setattr("follower.ui.video.rtsp_server._BEHIND_BYTES", nothing_is_little_enough)
    with ask(server[1].port, "SETUP", "Transport: RTP/AVP/TCP;unicast") as one:
        one.sendall(request("PLAY"))
        assert is_hung_up_on(one)


@pytest.mark.slow
def test_who_reads_slowly_gets_new_pictures_not_those_that_were_kept_for_him(live: Live) -> None:
    """Linux would keep megabytes for a slow line: fifteen seconds of the video as it is set."""
    channel = VideoChannel(replace(SETTINGS, bitrate_kbit_s=50_000), overlay=False)
    server = RtspServer(channel, Address("127.0.0.1", 0))
    asyncio.run_coroutine_threadsafe(server.start(), live.loop).result(PATIENCE_S)
    noise = np.random.default_rng(1).integers(0, 255, (30, 480, 640, 3), np.uint8)
    with socket.socket() as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 14)
        slow.connect(("127.0.0.1", server.port))
        slow.sendall(request("SETUP", "Transport: RTP/AVP/TCP;unicast") + request("PLAY"))
        until(lambda: channel.watched)
        for number, image in enumerate(noise):
            channel.show(Picture(image, number, number / 30))
        slow.settimeout(1.0)
        kept = 0
        with contextlib.suppress(TimeoutError):
            while data := slow.recv(1 << 16):
                kept += len(data)
    asyncio.run_coroutine_threadsafe(server.close(), live.loop).result(PATIENCE_S)
    assert 100_000 < kept < 1_200_000


def test_setting_up_again_and_again_keeps_one_socket(server: tuple[Live, RtspServer]) -> None:
    transport = "Transport: RTP/AVP;unicast;client_port=40000-40001"
    with ask(server[1].port, "OPTIONS") as connection:
        connection.recv(4096)
        before = len(list(Path("/proc/self/fd").iterdir()))
        for _ in range(20):
            connection.sendall(request("SETUP", transport))
            assert b"200 OK" in connection.recv(4096)
        assert len(list(Path("/proc/self/fd").iterdir())) <= before + 1


class Recording:
    """An RTSP server to which a stream is pushed; counts what comes."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"rtsp://127.0.0.1:{self._listener.getsockname()[1]}/drone"
        self.methods: list[str] = []
        self.pictures = 0
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._listener.close()
        self._thread.join(PATIENCE_S)

    def _serve(self) -> None:
        connection, _ = self._listener.accept()
        with connection, connection.makefile("rb") as file, contextlib.suppress(OSError):
            while head := file.read(1):
                if head == b"$":
                    _, length = struct.unpack("!BH", file.read(3))
                    packet = file.read(length)
                    self.pictures += len(packet) > 12 and bool(packet[1] & 0x80)
                else:
                    self._answer(head, file, connection)

    def _answer(self, head: bytes, file: object, connection: socket.socket) -> None:
        lines = [(head + file.readline()).decode()]  # type: ignore[attr-defined]
        while (line := file.readline().decode()).strip():  # type: ignore[attr-defined]
            lines.append(line)
        text = "".join(lines)
        length = re.search(r"(?i)content-length: (\d+)", text)
        file.read(int(length[1]) if length else 0)  # type: ignore[attr-defined]
        self.methods.append(text.split()[0])
        number = re.search(r"CSeq: (\d+)", text)
        transport = re.search(r"Transport: .*", text)
        answer = ["RTSP/1.0 200 OK", f"CSeq: {number[1] if number else 0}", "Session: 1"]
        answer += [transport[0].strip()] if transport else []
        connection.sendall("\r\n".join([*answer, "", ""]).encode())


@pytest.mark.slow
def test_it_is_pushed_to_a_server(live: Live) -> None:
    there = Recording()
    push = RtspPush(there.url)
    leave = live.channel.watch(push)
    until(lambda: there.pictures > 10)
    assert there.methods[:3] == ["ANNOUNCE", "SETUP", "RECORD"]
    leave()
    push.close()
    there.close()


def test_a_server_that_is_not_there_is_told_and_costs_nothing(live: Live) -> None:
    said: list[str] = []
    push = RtspPush("rtsp://127.0.0.1:9/drone", said.append)
    leave = live.channel.watch(push)
    until(lambda: said)
    assert push.problem is not None
    assert push.problem in said[0]
    leave()
    push.close()
