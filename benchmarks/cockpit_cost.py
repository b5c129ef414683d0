"""What cockpit and live video cost the control loop.

    python benchmarks/cockpit_cost.py [ROUNDS [SECONDS]]

The threads are those of a flight: capture, vision, control, and a simulated autopilot reached by
UDP; the camera gives 640x480 pictures at 30 Hz, of which the correlation tracker follows a part.
Each round goes through all rows, so that whatever else the computer does falls on all of them:

    off       neither page nor video
    off again the same: how far two rows differ by chance
    MJPEG     the page's pictures for one reader, three WebSockets
    WebRTC    the page in headless Chromium, live, and two more WebSockets
    RTSP      video with overlay for one ffmpeg by TCP, and RTP by UDP; no page

Where there is a page, a setting is changed each second. Measured is how late each control step
begins and how long it takes. Promise: the p99 of both moves by less than 0.5 ms. A round takes
five times SECONDS and half a minute more.

On a computer that others use, `chrt -r 10 python benchmarks/cockpit_cost.py` measures as on a quiet
one: the flight goes first. The station gives way by itself, and so do those who watch.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import command_line
import cv2
import numpy as np
from rich.progress import track as progress

from follower.flight.control.loop import ControlLoop
from follower.flight.control.stage import ControlStage
from follower.flight.log import FlightLog
from follower.flight.operator_requests import OperatorRequests
from follower.flight.status import LiveStatus
from follower.flight.target.selectors import box_selector
from follower.flight.threads import RealtimeRun, VisionLoop
from follower.flight.vision.stage import VisionStage
from follower.flight.vision.tracker_factory import make_target_tracker
from follower.links.connections import open_connection
from follower.links.pymavlink_link import MavlinkLink
from follower.settings.settings import Settings, load_settings
from follower.ui.cockpit.publisher import FlightPublisher, initial_state
from follower.ui.cockpit.start import open_station
from follower.ui.ipc.server_client import UiProcessClient
from follower_sim.autopilot.autopilot import SimAutopilot, autopilot_thread
from follower_sim.kinematics import BodyState
from follower_vision.clock import Clock, MonotonicClock
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import ClosesItself

WIDTH, HEIGHT, CAMERA_HZ = 640, 480, 30.0
ADDRESS = "127.0.0.1:14594"
RTP_ADDRESS = "127.0.0.1:5699"
ROWS: dict[str, tuple[str, ...] | None] = {
    "off": None,
    "off again": None,
    "MJPEG": ("cockpit.port=0",),
    "WebRTC": ("cockpit.port=0",),
    "RTSP": ("video.rtsp=127.0.0.1:0", f"video.udp={RTP_ADDRESS}"),
}
"""What each row sets, None without a station."""


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
        return Frame(np.asarray(image, np.uint8), self._clock.now(), self._sequence)

    def close(self) -> None:
        """Nothing is held."""


def fly(seconds: float, settings: Settings, station: UiProcessClient | None) -> FlightLog:
    """Fly for some seconds and return what was noted."""
    log, clock = FlightLog(), MonotonicClock()
    requests = OperatorRequests(settings)
    with (
        closing(open_connection(f"udpin:{ADDRESS}")) as ours,
        closing(open_connection(f"udpout:{ADDRESS}")) as theirs,
    ):
        autopilot = SimAutopilot("ardupilot", theirs, BodyState(0.0, (0.0, 0.0, -20.0)))
        autopilot.switch_mode("GUIDED")
        vision_stage = VisionStage(make_target_tracker(settings), requests)
        vision_stage.select(box_selector(Box(320.0, 240.0, 60.0, 45.0)))
        vision = VisionLoop(vision_stage, clock, log, station)
        model = settings.camera.model(WIDTH, HEIGHT)
        stage = ControlStage(settings, model, log, requests=requests)
        control = ControlLoop(MavlinkLink(ours), stage, lambda: vision.tracks.newest, log)
        page = None if station is None else FlightPublisher(station, _Shown(requests, stage, log))
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

        with autopilot_thread(autopilot, clock):
            run.run(watch)
    log.controls = [one for one in log.controls if one.time_s > begin_s + 1.0]
    return log


class _Shown:
    """What the page is shown."""

    def __init__(self, requests: OperatorRequests, stage: ControlStage, log: FlightLog) -> None:
        self.requests, self.stage, self.log = requests, stage, log


def main() -> None:
    """Measure and print."""
    parser = command_line.parser(__doc__)
    parser.add_argument("rounds", nargs="?", type=command_line.count, default=6)
    parser.add_argument("seconds", nargs="?", type=command_line.positive, default=15.0)
    options = parser.parse_args()
    rounds, seconds = options.rounds, options.seconds
    found: dict[str, list[FlightLog]] = {row: [] for row in ROWS}
    seen: dict[str, list[str]] = {row: [] for row in ROWS}
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores at the start")
    for _ in progress(range(rounds), "rounds"):
        for row, overrides in ROWS.items():
            log, watched = fly_watched(row, overrides, seconds)
            found[row].append(log)
            seen[row].append(watched)
    print(f"load {os.getloadavg()[0]:.1f} at the end; {rounds} rounds of {seconds:.0f} s each")
    for what, of in (("late_s", "step begins late by"), ("busy_s", "step takes")):
        report(of, found, what)
    for row, rates in seen.items():
        if ROWS[row] is not None:
            print(f"{row}: pictures a second seen, by rounds: {' '.join(rates)}")


def fly_watched(
    row: str, overrides: tuple[str, ...] | None, seconds: float
) -> tuple[FlightLog, str]:
    """Fly with somebody who watches in a row's way; return the log and how many pictures came."""
    settings = load_settings(None, None, overrides or ())
    if overrides is None:
        return fly(seconds, settings, None), ""
    with ExitStack() as stack:
        station, url = open_watched(stack, row, settings)
        viewer = stack.enter_context(watching(row.lower(), url))
        log = fly(seconds, settings, station)
        counted, _ = viewer.communicate(timeout=30)
    words = counted.split()
    rate = float(words[0]) / float(words[1]) if float(words[1]) else 0.0
    return log, " ".join((f"{rate:.1f}", *words[2:]))


def open_watched(stack: ExitStack, row: str, settings: Settings) -> tuple[UiProcessClient, str]:
    """Open a row's station, and return it with where it is to be watched."""
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    said: list[str] = []
    page = initial_state("fly", "cost", settings)
    station = open_station(settings, row != "RTSP", page, folder, said.append)
    assert station is not None
    stack.enter_context(station)
    while not (url := re.search(r"(?:http|rtsp)://\S+", " ".join(said))):
        time.sleep(0.1)
    return station, url[0]


@contextmanager
def watching(way: str, url: str) -> Iterator[subprocess.Popen[str]]:
    """Have somebody watch, who is there before the flight begins."""
    command = [sys.executable, str(Path(__file__).with_name("cockpit_viewer.py")), way, url]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as viewer:
        assert viewer.stdout is not None
        if not viewer.stdout.readline():
            raise SystemExit(f"nobody could watch by {way}")
        try:
            yield viewer
        finally:
            viewer.kill()


def report(name: str, found: dict[str, list[FlightLog]], what: str) -> None:
    """Print the percentiles of each row, and by how much its p99 differs in each round."""
    print(f"{name + ', ms':26}{'median':>9}{'p99':>9}{'max':>9}  p99 less that of off, by rounds")
    off = [p99_ms(log, what) for log in found["off"]]
    for row, logs in found.items():
        ms = 1e3 * np.array([getattr(one, what) for log in logs for one in log.controls])
        moved = [p99_ms(log, what) - before for log, before in zip(logs, off, strict=True)]
        print(
            f"  {row:24}{np.median(ms):9.3f}{np.percentile(ms, 99):9.3f}{ms.max():9.3f}  "
            + " ".join(f"{one:+.3f}" for one in moved)
        )


def p99_ms(log: FlightLog, what: str) -> float:
    """Return the 99th percentile of one flight's steps."""
    return 1e3 * float(np.percentile([getattr(one, what) for one in log.controls], 99))


if __name__ == "__main__":
    command_line.run(main)
