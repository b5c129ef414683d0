"""One who watches, for `cockpit_cost.py`.

    python benchmarks/cockpit_viewer.py WAY ADDRESS

WAY is `mjpeg`, `webrtc` or `rtsp`. It prints a line when it is there, and after its input has
ended, how many pictures came and in how many seconds. It gives way to everything else on this
computer: on a real flight it runs elsewhere.
"""

from __future__ import annotations

import argparse
import os
import shutil
import socket
import sys
import threading
import time
from collections.abc import Callable
from urllib.parse import urlsplit

import av
import av.error
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

_TRIES_S = 20.0
_AT_ONCE = {"fflags": "nobuffer", "flags": "low_delay", "probesize": "2048", "analyzeduration": "0"}


class Counter:
    """How many pictures came between the first and the last."""

    def __init__(self) -> None:
        self._times: list[float] = []

    def note(self) -> None:
        """Count one."""
        self._times.append(time.monotonic())

    def __str__(self) -> str:
        seconds = self._times[-1] - self._times[0] if self._times else 0.0
        return f"{len(self._times)} {seconds:.2f}"


def begin(what: Callable[..., None], *arguments: object) -> None:
    """Do this on a thread that nobody waits for."""
    threading.Thread(target=what, args=arguments, daemon=True).start()


def by_websocket(url: str) -> None:
    """Hear every moment, as a page does."""
    try:
        with connect(url.replace("http", "ws") + "/ws") as client:
            for number in range(10**9):
                client.recv()
                if number % 8 == 0:
                    client.send('{"kind": "ping"}')
    except (OSError, ConnectionClosed):
        return


def by_mjpeg(url: str, counter: Counter) -> None:
    """Read the pictures one after the other."""
    where = urlsplit(url)
    request = f"GET /video.mjpeg HTTP/1.1\r\nHost: {where.netloc}\r\n\r\n"
    with socket.create_connection((where.hostname, where.port)) as line:
        line.sendall(request.encode())
        while data := line.recv(1 << 18):
            for _ in range(data.count(b"--picture")):
                counter.note()


def by_rtsp(url: str, counter: Counter) -> None:
    """Decode as a ground station does; the flight may not have begun yet."""
    end_s = time.monotonic() + _TRIES_S
    while time.monotonic() < end_s:
        try:
            with av.open(
                url, options={**_AT_ONCE, "rtsp_transport": "tcp"}, timeout=5
            ) as container:
                stream = container.streams.video[0]
                stream.codec_context.thread_count = 1
                for _ in container.decode(stream):
                    counter.note()
                return
        except av.error.FFmpegError:
            time.sleep(0.2)


def by_page(url: str) -> str:
    """Show the page in Chromium, and return what its video element counted."""
    from playwright.sync_api import sync_playwright

    arguments = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=arguments
        )
        page = browser.new_page(viewport={"width": 1280, "height": 1000})
        page.goto(url)
        page.wait_for_selector("#connection:has-text('connected')")
        # The page allows no `eval`, by which Playwright would wait for a condition.
        while page.evaluate("() => window.peer && window.peer.connectionState") != "connected":
            page.wait_for_timeout(100)
        print("there", flush=True)
        sys.stdin.read()
        way = page.get_attribute("#stage", "data-video")
        look = "v => [v.getVideoPlaybackQuality().totalVideoFrames, v.currentTime]"
        count, seconds = page.eval_on_selector("#video", look)
        browser.close()
    return f"{count} {seconds:.2f}" if way == "webrtc" else f"0 0 it showed {way}"


def main() -> None:
    """Watch until the input ends, then tell."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("way", choices=("mjpeg", "webrtc", "rtsp"))
    parser.add_argument("address")
    options = parser.parse_args()
    way, address = options.way, options.address
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(10)
    counter = Counter()
    for _ in range({"mjpeg": 3, "webrtc": 2, "rtsp": 0}[way]):
        begin(by_websocket, address)
    if way == "webrtc":
        print(by_page(address))
        return
    counter = Counter()
    begin(by_mjpeg if way == "mjpeg" else by_rtsp, address, counter)
    print("there", flush=True)
    sys.stdin.read()
    print(counter)


if __name__ == "__main__":
    main()
