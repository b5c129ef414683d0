"""What cockpit and live video cost the control loop.

    python benchmarks/cockpit_cost.py [ROUNDS [SECONDS]]

The threads are those of a flight: capture, vision, control, and a simulated autopilot reached by
UDP; the camera gives 640x480 pictures at 30 Hz, of which the correlation tracker follows a part.
Rounds without a station and with one change places, so that whatever else the computer does falls
on both. With one, the page has three clients by WebSocket and one by MJPEG, RTP goes out by UDP
with an overlay, and a chosen setting is changed each second. Measured is how late each control step
begins and how long it takes. Promise: the p99 of both moves by less than 0.5 ms.

On a computer that others use, `chrt -r 10 python benchmarks/cockpit_cost.py` measures as on a quiet
one: it goes first, and so does the station.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, closing
from pathlib import Path

import cv2
import numpy as np

from follower.cockpit.opening import open_station
from follower.cockpit.showing import FlightShow, first_page
from follower.control_loop import ControlLoop
from follower.control_stage import ControlStage
from follower.flightlog import FlightLog
from follower.links.connection import open_connection
from follower.links.mavlink import MavlinkLink
from follower.live_status import LiveStatus
from follower.operator_requests import OperatorRequests
from follower.realtime import RealtimeRun, VisionLoop
from follower.selecting import box_selector
from follower.settings import Settings, load_settings
from follower.station.station import Station
from follower.tracking import make_target_tracker
from follower.vision_stage import VisionStage
from follower_sim.autopilot import SimAutopilot, run_autopilot
from follower_sim.kinematics import BodyState
from follower_vision.box import Box
from follower_vision.clock import Clock, MonotonicClock
from follower_vision.frame import Frame
from follower_vision.framesource import ClosesItself

WIDTH, HEIGHT, CAMERA_HZ = 640, 480, 30.0
ADDRESS = "127.0.0.1:14594"
CLIENTS = """
import socket, sys, threading, time
from websockets.sync.client import connect
port = int(sys.argv[1])
def watch():
    with connect(f"ws://127.0.0.1:{port}/ws") as client:
        for number in range(10**9):
            client.recv()
            if number % 8 == 0:
                client.send('{"kind": "ping"}')
for _ in range(3):
    threading.Thread(target=watch, daemon=True).start()
with socket.create_connection(("127.0.0.1", port)) as video:
    video.sendall(f"GET /video.mjpeg HTTP/1.1\\r\\nHost: 127.0.0.1:{port}\\r\\n\\r\\n".encode())
    while video.recv(65536):
        pass
"""


class Camera(ClosesItself):
    """Gives a textured picture that drifts."""

    nominal_rate_hz = CAMERA_HZ
    frame_count: int | None = None
    problem: str | None = None

    def __init__(self, clock: Clock) -> None:
        rng = np.random.default_rng(1)
        small = rng.integers(0, 255, (HEIGHT // 12, WIDTH // 12, 3), dtype=np.uint8)
        self._ground = cv2.resize(small, (WIDTH + 64, HEIGHT + 64), interpolation=cv2.INTER_CUBIC)
        self._clock = clock
        self._start_s = clock.now()
        self._sequence = 0

    def read(self) -> Frame:
        """Return the next picture."""
        self._sequence += 1
        self._clock.sleep_until(self._start_s + self._sequence / CAMERA_HZ)
        shift = self._sequence // 4 % 64
        image = np.ascontiguousarray(self._ground[shift : shift + HEIGHT, shift : shift + WIDTH])
        return Frame(image, self._clock.now(), self._sequence)

    def close(self) -> None:
        """Nothing is held."""


def fly(seconds: float, settings: Settings, station: Station | None) -> FlightLog:
    """Fly for some seconds and return what was noted."""
    log, clock = FlightLog(), MonotonicClock()
    requests = OperatorRequests(settings)
    with (
        closing(open_connection(f"udpin:{ADDRESS}")) as ours,
        closing(open_connection(f"udpout:{ADDRESS}")) as theirs,
    ):
        autopilot = SimAutopilot("ardupilot", theirs, BodyState(0.0, (0.0, 0.0, -20.0)))
        autopilot.switch_mode("GUIDED")
        stop = threading.Event()
        thread = threading.Thread(target=run_autopilot, args=(autopilot, clock, stop))
        thread.start()
        vision_stage = VisionStage(make_target_tracker(settings), requests)
        vision_stage.select(box_selector(Box(320.0, 240.0, 60.0, 45.0)))
        vision = VisionLoop(vision_stage, clock, log, station)
        model = settings.camera.model(WIDTH, HEIGHT)
        stage = ControlStage(settings, model, log, requests=requests)
        control = ControlLoop(MavlinkLink(ours), stage, lambda: vision.tracks.newest, log)
        page = None if station is None else FlightShow(station, _Shown(requests, stage, log))
        run = RealtimeRun(clock, Camera(clock), vision, control, settings.control_rate_hz)
        begin_s, changed_s = clock.now(), clock.now()

        def watch() -> bool:
            nonlocal changed_s
            status = LiveStatus.of(log, begin_s, None, stage.servo.errors)
            if page is not None:
                page.show(status)
                if clock.now() - changed_s > 1.0:
                    changed_s = clock.now()
                    gain = 1.0 + 0.1 * (int(changed_s) % 5)
                    requests.change("servo.azimuth.kp", gain, "the benchmark")
            return clock.now() - begin_s < seconds + 1.0

        run.run(watch)
        stop.set()
        thread.join()
    log.controls = [one for one in log.controls if one.time_s > begin_s + 1.0]
    return log


class _Shown:
    """What the page is shown."""

    def __init__(self, requests: OperatorRequests, stage: ControlStage, log: FlightLog) -> None:
        self.requests, self.stage, self.log = requests, stage, log


def main() -> None:
    """Measure and print."""
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 6
    seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 15.0
    settings = load_settings(None, None, ("cockpit.port=0", "video.udp=127.0.0.1:5699"))
    found: dict[bool, list[FlightLog]] = {False: [], True: []}
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores at the start")
    for number in range(2 * rounds):
        shown = number % 2 == 1
        with ExitStack() as stack:
            station = _with_clients(stack, settings) if shown else None
            found[shown].append(fly(seconds, settings, station))
    print(f"load {os.getloadavg()[0]:.1f} at the end; {rounds} rounds of {seconds:.0f} s each")
    for what, of in (("late_s", "step begins late by"), ("busy_s", "step takes")):
        report(of, found, what)


def _with_clients(stack: ExitStack, settings: Settings) -> Station:
    folder = stack.enter_context(tempfile.TemporaryDirectory())
    said: list[str] = []
    page = first_page("fly", "cost", settings)
    station = open_station(settings, True, page, Path(folder), said.append)
    assert station is not None
    stack.enter_context(station)
    while not (port := re.search(r"127.0.0.1:(\d+)$", " ".join(said))):
        time.sleep(0.1)
    clients = subprocess.Popen(
        [sys.executable, "-c", CLIENTS, port[1]],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: os.nice(10),
    )
    stack.callback(clients.wait)
    stack.callback(clients.kill)
    time.sleep(2.0)
    return station


def report(name: str, found: dict[bool, list[FlightLog]], what: str) -> None:
    """Print the percentiles without and with a station, and each pair's difference of the p99."""
    print(f"{name + ', ms':26}{'median':>9}{'p99':>9}{'max':>9}")
    for shown, logs in found.items():
        ms = 1e3 * np.array([getattr(one, what) for log in logs for one in log.controls])
        label = "  with cockpit and video" if shown else "  without"
        print(f"{label:26}{np.median(ms):9.3f}{np.percentile(ms, 99):9.3f}{ms.max():9.3f}")
    p99 = {
        shown: [1e3 * np.percentile([getattr(c, what) for c in log.controls], 99) for log in logs]
        for shown, logs in found.items()
    }
    differences = np.array(p99[True]) - np.array(p99[False])
    print(f"  p99, with less without, by rounds: {np.round(differences, 3).tolist()}")


if __name__ == "__main__":
    main()
