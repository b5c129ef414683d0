"""From a frame in the flight's memory to the same frame decoded by a viewer, on this computer.

    python benchmarks/video_delay.py [SECONDS]

A time code is drawn into pictures of 640x480 at 30 Hz, which go the whole way: to the station's
process, through the encoder, by network to a viewer, and through its decoder. The viewers: RTP by
UDP and RTSP as ffmpeg plays them without buffering, and the cockpit's page in headless Chromium,
by WebRTC and by MJPEG. What a camera and a screen add on top is not measured here.
"""

from __future__ import annotations

import os
import re
import shutil
import socket
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import av
import command_line
import cv2
import numpy as np

from follower.settings.settings import load_settings
from follower.ui.cockpit.publisher import initial_state
from follower.ui.cockpit.start import open_station
from follower.ui.ipc.server_client import UiProcessClient
from follower_vision.images.frame import Frame, Image

WIDTH, HEIGHT, RATE_HZ = 640, 480, 30.0
BITS, BLOCK_PX = 20, 24
QUICK = {"fflags": "nobuffer", "flags": "low_delay", "probesize": "2048", "analyzeduration": "0"}
LOOK = """
seconds => new Promise(done => {
  const video = document.querySelector('#video'), image = document.querySelector('#mjpeg');
  const canvas = new OffscreenCanvas(WIDTH, BLOCK), c = canvas.getContext('2d');
  const delays = [], end = performance.now() + 1000 * seconds; let last = -1;
  const look = () => {
    c.drawImage(image.hidden ? video : image, 0, 0);
    const row = c.getImageData(0, BLOCK / 2, WIDTH, 1).data; let code = 0;
    for (let bit = 0; bit < BITS; bit++)
      code += row[4 * (bit * BLOCK + BLOCK / 2)] > 127 ? 2 ** bit : 0;
    const now = Date.now() % 2 ** BITS;
    if (code !== last && code) delays.push((now - code + 2 ** BITS) % 2 ** BITS);
    last = code;
    if (performance.now() > end) done(delays); else setTimeout(look, 2);
  };
  look();
})
"""
"""Reads the time codes in the page's picture. Capital letters stand for the numbers above."""


def free_port(kind: socket.SocketKind) -> int:
    """Return a port that nobody has."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def coded(image: Image, code: int) -> Image:
    """Return the image with a number drawn into its top."""
    image = image.copy()
    for bit in range(BITS):
        value = 255 if code >> bit & 1 else 0
        image[:BLOCK_PX, bit * BLOCK_PX : (bit + 1) * BLOCK_PX] = value
    return image


def code_in(image: Image) -> int:
    """Return the number that is drawn into an image."""
    row = image[BLOCK_PX // 2, BLOCK_PX // 2 : BITS * BLOCK_PX : BLOCK_PX, 1]
    return int(sum(1 << bit for bit, value in enumerate(row) if value > 127))


def now_code() -> int:
    """Return the time in ms, as far as its bits go; the browser has the same clock."""
    return int(1000 * time.time()) % (1 << BITS)


class Source:
    """Gives a station pictures with the time in them."""

    def __init__(self, station: UiProcessClient) -> None:
        self._station = station
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Give no more."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        small = np.random.default_rng(1).integers(60, 180, (HEIGHT // 8, WIDTH // 8, 3), np.uint8)
        ground = cv2.resize(small, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
        number, due_s = 0, time.monotonic()
        while not self._stop.is_set():
            image = coded(np.roll(ground, 2 * number, 1), now_code())
            self._station.add(Frame(image, due_s, number), (), ())
            number += 1
            due_s += 1 / RATE_HZ
            time.sleep(max(0.0, due_s - time.monotonic()))


def delays(address: str, options: dict[str, str], seconds: float) -> Iterator[int]:
    """Give the delay of each frame that ffmpeg decodes, in ms."""
    with av.open(address, options={**QUICK, **options}, timeout=10) as container:
        stream = container.streams.video[0]
        stream.thread_type, stream.codec_context.thread_count = "NONE", 1
        begin_s = time.monotonic()
        for frame in container.decode(stream):
            image = np.asarray(frame.to_ndarray(format="bgr24"), np.uint8)
            late = (now_code() - code_in(image)) % (1 << BITS)
            if time.monotonic() - begin_s > 2.0:  # what waited while the viewer began is gone
                yield late
            if time.monotonic() - begin_s > seconds + 2.0:
                return


def on_page(url: str, seconds: float, webrtc: bool) -> list[int]:
    """Return the delays that the cockpit's page has, in ms."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        arguments = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=arguments
        )
        page = browser.new_page()
        if not webrtc:
            page.add_init_script("delete window.RTCPeerConnection")
        page.goto(url)
        way = "webrtc" if webrtc else "mjpeg"
        page.wait_for_selector(f"#stage[data-video={way}]", timeout=60_000)
        page.wait_for_timeout(2000)
        look = LOOK.replace("WIDTH", str(WIDTH)).replace("BLOCK", str(BLOCK_PX))
        found = page.evaluate(look.replace("BITS", str(BITS)), seconds)
        browser.close()
    return list(found)


def take_along(process_id: int) -> None:
    """Give the station our real-time priority, if we have one: by itself it gives way."""
    policy = os.sched_getscheduler(0)
    if policy != os.SCHED_OTHER:
        for task in Path(f"/proc/{process_id}/task").iterdir():
            os.sched_setscheduler(int(task.name), policy, os.sched_getparam(0))


def report(name: str, found: list[int]) -> None:
    """Print a line of the table."""
    p50, p95, worst = (np.percentile(found, q) for q in (50, 95, 100))
    print(f"{name:34}{p50:8.0f}{p95:8.0f}{worst:8.0f}{len(found):9}")


def main() -> None:
    """Measure and print."""
    parser = command_line.parser(__doc__)
    parser.add_argument("seconds", nargs="?", type=command_line.positive, default=10.0)
    seconds: float = parser.parse_args().seconds
    udp, rtsp = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
    video = (f"video.udp=127.0.0.1:{udp}", f"video.rtsp=127.0.0.1:{rtsp}", "video.overlay=false")
    settings = load_settings(None, None, ("cockpit.port=0", *video))
    said: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        page = initial_state("fly", "delay", settings)
        station = open_station(settings, True, page, Path(folder), said.append)
        assert station is not None
        sdp = Path(folder) / "stream.sdp"
        sdp.write_text(
            f"v=0\nc=IN IP4 127.0.0.1\nm=video {udp} RTP/AVP 96\na=rtpmap:96 H264/90000\n"
        )
        with station:
            while not any("Cockpit" in line for line in said):
                time.sleep(0.1)
            url = re.search(r"http://[^/]*", " ".join(said))
            assert url is not None
            take_along(station.process_id)
            source = Source(station)
            print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
            print(f"{'ms from memory to decoded':34}{'median':>8}{'p95':>8}{'max':>8}{'frames':>9}")
            allowed = {"protocol_whitelist": "file,udp,rtp", "reorder_queue_size": "0"}
            report("RTP by UDP", list(delays(str(sdp), allowed, seconds)))
            live = f"rtsp://127.0.0.1:{rtsp}/live"
            report("RTSP by UDP", list(delays(live, {"rtsp_transport": "udp"}, seconds)))
            report("RTSP by TCP", list(delays(live, {"rtsp_transport": "tcp"}, seconds)))
            report("page, WebRTC", on_page(url[0], seconds, True))
            report("page, MJPEG", on_page(url[0], seconds, False))
            source.close()


if __name__ == "__main__":
    command_line.run(main)
