"""Live video: what viewers get who speak RTP and RTSP as everybody does."""

from __future__ import annotations

import asyncio
import contextlib
import re
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower.settings.ui import Address, VideoSettings
from follower.ui.video.channel import Picture, VideoChannel
from follower.ui.video.h264_encoder import (
    AccessUnit,
    EncoderError,
    H264Encoder,
    fitted,
    make_encoder,
)
from follower.ui.video.rtp import RtpPacketiser, RtpSender, nal_units, session_description
from follower.ui.video.rtsp_push import RtspPush
from follower.ui.video.rtsp_server import RtspServer
from follower_vision.geometry.box import Box
from follower_vision.trackers.track import Track, TrackState

WIDTH, HEIGHT = 160, 120
SETTINGS = VideoSettings(encoder="libx264", keyframe_s=0.5)
PATIENCE_S = 20.0


def image(number: int) -> np.ndarray:
    """A grey picture with a bright square that moves to the right."""
    picture = np.full((HEIGHT, WIDTH, 3), 60, np.uint8)
    x = 10 + number % 100
    picture[40:80, x : x + 40] = 220
    return picture


def picture(number: int) -> Picture:
    return Picture(image(number), number, number / 30)


def units(count: int) -> list[AccessUnit]:
    encoder = H264Encoder("libx264", SETTINGS, WIDTH, HEIGHT)
    made = [encoder.encode(image(number), number / 30) for number in range(count)]
    return [unit for unit in made if unit is not None]


# The encoder.


def test_each_picture_comes_out_at_once_and_can_be_decoded() -> None:
    made = units(31)
    assert len(made) == 31
    decoder = av.CodecContext.create("h264", "r")
    decoder.thread_count = 1
    frames = [frame for unit in made for frame in decoder.decode(av.Packet(unit.data))]
    frames += decoder.decode(None)
    assert len(frames) == 31
    for number, frame in enumerate(frames):
        error = frame.to_ndarray(format="bgr24").astype(int) - image(number)
        assert np.abs(error).mean() < 6


def test_key_pictures_come_in_time_with_their_parameter_sets() -> None:
    made = units(46)
    keys = [number for number, unit in enumerate(made) if unit.is_key]
    assert keys == [0, 15, 30, 45]
    for number in keys:
        kinds = [nal[0] & 0x1F for nal in nal_units(made[number].data)]
        assert {7, 8, 5} <= set(kinds)
    assert [unit.ticks for unit in made[:3]] == [0, 3000, 6000]


def test_a_clock_that_goes_back_makes_no_time_twice() -> None:
    encoder = H264Encoder("libx264", SETTINGS, WIDTH, HEIGHT)
    ticks = [encoder.encode(image(0), time_s).ticks for time_s in (5.0, 4.0, 5.0)]  # type: ignore[union-attr]
    assert ticks == sorted(set(ticks))


def test_the_first_encoder_that_works_is_taken() -> None:
    assert make_encoder(VideoSettings(), 64, 64).name in ("h264_nvenc", "h264_v4l2m2m", "libx264")
    if Path("/dev/video11").exists():
        pytest.skip("this computer has the encoder that is to be missing")
    with pytest.raises(EncoderError, match="h264_v4l2m2m"):
        make_encoder(VideoSettings(encoder="h264_v4l2m2m"), 64, 64)


@given(st.integers(2, 700), st.integers(2, 500), st.integers(64, 800))
def test_pictures_are_fitted_to_even_sizes(width: int, height: int, most: int) -> None:
    small = fitted(np.zeros((height, width, 3), np.uint8), most)
    assert small.shape[0] % 2 == small.shape[1] % 2 == 0
    assert small.shape[1] <= most
    scale = small.shape[1] / width
    assert abs(small.shape[0] - max(2, scale * height)) <= 2 + 2 * height / width


# RTP.


def depacketised(packets: list[bytes]) -> bytes:
    """Return what an RFC 6184 receiver makes of packets."""
    stream = b""
    for packet in packets:
        payload = packet[12:]
        if payload[0] & 0x1F != 28:
            stream += b"\0\0\0\1" + payload
        elif payload[1] & 0x80:
            stream += b"\0\0\0\1" + bytes([(payload[0] & 0xE0) | (payload[1] & 0x1F)]) + payload[2:]
        else:
            stream += payload[2:]
    return stream


@given(
    st.lists(st.binary(min_size=1, max_size=4000), min_size=1, max_size=4), st.integers(0, 1 << 40)
)
def test_packets_hold_what_was_packed(bodies: list[bytes], ticks: int) -> None:
    nals = [b"\x65" + body.replace(b"\0", b"\1") for body in bodies]
    data = b"".join(b"\0\0\0\1" + nal for nal in nals)
    assert nal_units(data) == nals
    packets = RtpPacketiser(7, 0xFFFF).pack(AccessUnit(data, ticks, True))
    assert depacketised(packets) == data
    heads = [struct.unpack("!BBHII", packet[:12]) for packet in packets]
    assert [head[2] for head in heads] == [(0xFFFF + n) & 0xFFFF for n in range(len(packets))]
    assert [bool(head[1] & 0x80) for head in heads] == [False] * (len(packets) - 1) + [True]
    assert {head[3] for head in heads} == {ticks & 0xFFFFFFFF}
    assert max(map(len, packets)) <= 1212


def test_the_description_names_the_parameter_sets() -> None:
    text = session_description(units(1)[0])
    assert re.search(r"profile-level-id=42[0-9a-f]{4};sprop-parameter-sets=[\w+/=]+,[\w+/=]+", text)
    assert "sprop" not in session_description(None)


# The channel.


def test_nothing_is_encoded_while_nobody_watches() -> None:
    channel, seen = VideoChannel(SETTINGS, overlay=False), list[AccessUnit]()
    channel.show(picture(0))
    leave = channel.watch(seen.append)
    channel.show(picture(1))
    assert [unit.is_key for unit in seen] == [True]
    leave()
    channel.show(picture(2))
    assert len(seen) == 1
    assert not channel.watched


def test_who_comes_later_begins_with_a_key_picture() -> None:
    channel, first, second = VideoChannel(SETTINGS, False), list[AccessUnit](), list[AccessUnit]()
    channel.watch(first.append)
    for number in range(3):
        channel.show(picture(number))
    channel.watch(second.append)
    channel.show(picture(3))
    assert [unit.is_key for unit in first] == [True, False, False, True]
    assert second[0].is_key


def test_the_overlay_is_drawn_where_it_is_wanted() -> None:
    track = Track(Box(80, 60, 40, 30), TrackState.TRACKING, 1.0, "test", 0.0, 0)
    sizes = []
    for overlay in (False, True):
        channel, seen = VideoChannel(SETTINGS, overlay), list[AccessUnit]()
        channel.watch(seen.append)
        channel.show(
            Picture(np.full((HEIGHT, WIDTH, 3), 90, np.uint8), 0, 0.0, (track,), ("IDLE",))
        )
        sizes.append(len(seen[0].data))
    assert sizes[1] > 2 * sizes[0]


def test_a_new_size_of_pictures_goes_on() -> None:
    channel, seen = VideoChannel(SETTINGS, False), list[AccessUnit]()
    channel.watch(seen.append)
    channel.show(picture(0))
    channel.show(Picture(np.zeros((90, 120, 3), np.uint8), 1, 0.1))
    assert [unit.is_key for unit in seen] == [True, True]


# By the network.


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


def until(condition: Callable[[], object]) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)


@pytest.mark.parametrize(
    "wrong",
    [
        {"udp": "5600"},
        {"rtsp": "localhost"},
        {"push": "http://x"},
        {"push": "rtsp://x:port/drone"},
        {"push": "rtsp://"},
        {"bitrate_kbit_s": 1},
        {"keyframe_s": 0.0},
        {"max_width_px": 10},
    ],
)
def test_nonsense_settings_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValueError):  # noqa: PT011  each says what is right
        VideoSettings(**wrong)  # type: ignore[arg-type]
