"""RTSP, from a small server that speaks it over TCP as cameras do."""

import re
import socket
import threading
import time
from contextlib import contextmanager
from fractions import Fraction

import av
import numpy as np
import pytest

from follower_vision.sources.frame_source import SourceError
from follower_vision.sources.live_source import LiveSettings
from follower_vision.sources.open import open_source

QUICK = LiveSettings(first_frame_s=10.0, retry_s=0.05, longest_retry_s=0.2)
RATE, WIDTH, HEIGHT = 25, 96, 64
SDP = "\r\n".join(
    [
        *("v=0", "o=- 0 0 IN IP4 127.0.0.1", "s=test", "c=IN IP4 0.0.0.0", "t=0 0"),
        *("m=video 0 RTP/AVP 96", "a=rtpmap:96 H264/90000"),
        *("a=fmtp:96 packetization-mode=1", "a=control:streamid=0", ""),
    ]
)


class RtspCamera:
    """Answers OPTIONS, DESCRIBE, SETUP and PLAY, then sends RTP within the connection."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self.requests: list[str] = []
        self._cut = threading.Event()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def cut(self) -> None:
        """Break the connection there is."""
        self._cut.set()

    def close(self) -> None:
        self._closed.set()
        self._cut.set()
        socket.create_connection(("127.0.0.1", self.port)).close()
        self._thread.join(10)
        self._listener.close()

    def _serve(self) -> None:
        while not self._closed.is_set():
            connection, _ = self._listener.accept()
            self._cut.clear()
            with connection:
                if not self._closed.is_set() and self._negotiate(connection):
                    self._play(connection)

    def _negotiate(self, connection: socket.socket) -> bool:
        """Answer requests up to PLAY; return whether it came."""
        file = connection.makefile("rb")
        with file:
            while line := file.readline().decode():
                head = [line]
                while (more := file.readline().decode()).strip():
                    head.append(more)
                self.requests.append("".join(head))
                method = line.split()[0]
                connection.sendall(self._answer(method, "".join(head)))
                if method == "PLAY":
                    return True
        return False

    def _answer(self, method: str, request: str) -> bytes:
        number = re.search(r"CSeq: *(\d+)", request).group(1)
        lines = ["RTSP/1.0 200 OK", f"CSeq: {number}"]
        body = SDP if method == "DESCRIBE" else ""
        if method == "OPTIONS":
            lines.append("Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN")
        elif method == "DESCRIBE":
            lines += ["Content-Type: application/sdp", f"Content-Length: {len(body)}"]
        elif method == "SETUP":
            lines += ["Transport: RTP/AVP/TCP;unicast;interleaved=0-1", "Session: 1"]
        elif method == "PLAY":
            lines.append("Session: 1")
        return "\r\n".join([*lines, "", body]).encode()

    def _play(self, connection: socket.socket) -> None:
        """Pack H.264 into RTP by FFmpeg, through a socket of our own, into the connection."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as rtp:
            rtp.bind(("127.0.0.1", 0))
            rtp.setblocking(False)
            with sending_rtp(rtp.getsockname()[1]) as send:
                while not self._cut.wait(1 / RATE):
                    send()
                    try:
                        pass_on(rtp, connection)
                    except OSError:
                        return


@contextmanager
def sending_rtp(port: int):
    with av.open(f"rtp://127.0.0.1:{port}?pkt_size=1200", "w", format="rtp") as container:
        options = {"preset": "ultrafast", "tune": "zerolatency", "g": "5"}
        stream = container.add_stream("libx264", rate=RATE, options=options)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        count = 0

        def send() -> None:
            nonlocal count
            image = np.full((HEIGHT, WIDTH, 3), 20 + count % 200, np.uint8)
            frame = av.VideoFrame.from_ndarray(image, format="bgr24")
            frame.pts, frame.time_base = count, Fraction(1, RATE)
            container.mux(stream.encode(frame))
            count += 1

        yield send


def pass_on(rtp: socket.socket, connection: socket.socket) -> None:
    while True:
        try:
            packet = rtp.recv(65536)
        except BlockingIOError:
            return
        connection.sendall(b"$\x00" + len(packet).to_bytes(2, "big") + packet)


@pytest.fixture
def camera():
    camera = RtspCamera()
    yield camera
    camera.close()


@pytest.mark.slow
def test_pictures_come_by_rtsp_over_tcp_with_their_times(camera):
    with open_source(f"rtsp://127.0.0.1:{camera.port}/live", live=QUICK) as source:
        frames = [source.read() for _ in range(15)]
    assert frames[0].image.shape == (HEIGHT, WIDTH, 3)
    assert np.diff([frame.captured_s for frame in frames]).min() > 0
    setups = [request for request in camera.requests if request.startswith("SETUP")]
    assert "RTP/AVP/TCP" in setups[0]


@pytest.mark.slow
def test_a_cut_connection_is_made_again(camera):
    with open_source(f"rtsp://127.0.0.1:{camera.port}/live", live=QUICK) as source:
        last = source.read()
        camera.cut()
        end = time.monotonic() + 20
        while source.connections < 2 and time.monotonic() < end:
            last = source.read()
        again = source.read()
    assert source.connections >= 2
    assert again.sequence > last.sequence
    assert sum(request.startswith("PLAY") for request in camera.requests) == source.connections


def test_a_password_is_used_but_never_shown(free_port):
    port = free_port()
    settings = LiveSettings(first_frame_s=0.5, retry_s=0.05)
    with pytest.raises(SourceError) as caught:
        open_source(f"rtsp://pilot:secret@127.0.0.1:{port}/live", live=settings)
    assert f"rtsp://127.0.0.1:{port}/live" in str(caught.value)
    assert "secret" not in str(caught.value)
