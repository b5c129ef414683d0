"""What `follower fly` gives up first on a board that is too small: never control.

    python benchmarks/small_board.py [SECONDS [PERIOD_MS]]

The whole program, with the recorder and the process that sends video to people, flies for SECONDS
(20) with 1, 0.5 and 0.25 of a core, as the kernel's CPU controller shares it out (cgroup, version 1
or 2, as root). Outside of that quota are a simulated autopilot, reached by UDP, its pilot, and who
watches. The camera is a rendered film of 640x480 at 30 frames a second, played in real time; Fusion
runs the networks that come along.

Wanted is this order: vision's rate falls first, then frames are missing in the recording, then in
people's video; the 50 setpoints a second stay. A quota is harsher than a slow processor: when it is
spent, the kernel stops every thread, control's too, until the next PERIOD_MS (20) begin. No
priority helps; a shorter period stops them for less long at a time. The group comes before other
work on the computer; the last column is how many processes wanted to run.
"""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

import av
import command_line
import numpy as np

from follower.apps.bench.scene import BenchClip, render_clips
from follower.flight.supervision.supervisor import SupervisorState
from follower.recording import open_flight
from follower_control.common.transport import UdpTransport
from follower_sim.autopilot.autopilot import SimAutopilot, autopilot_thread
from follower_sim.kinematics import BodyState
from follower_vision.clock import MonotonicClock

SHARES = 1.0, 0.5, 0.25
SIZE, CAMERA_HZ, PICTURES = (640, 480), 30, 60
PATIENCE_S = 120.0
CONTROLLERS = Path("/sys/fs/cgroup")
FOLLOWER = [sys.executable, "-c", "from follower.apps.main import main; main()", "fly"]
SETTINGS = (
    *("tracker=re3", "detector=follower-detector", "link.vehicle_id=1", "camera.fov_deg=90"),
    *("camera.pitch_deg=-14", "servo.mode=watch"),
)
SKIPPED = (
    *("frame-rate", "frame-age", "attitude-rate", "position-rate", "attitude-age"),
    *("round-trip", "clocks", "packet-loss", "disk"),
)
"""Preflight checks that a computer fails which is too slow."""


class Figures(NamedTuple):
    """What came of one flight; times in milliseconds, rates in hertz."""

    late_p50: float
    late_p99: float
    control: float
    vision: float
    missing: int
    people: float


@contextmanager
def quota(share: float, period_us: int) -> Iterator[Path]:
    """Make a group of processes that gets that share of a core; yield the file for its members."""
    second = (CONTROLLERS / "cgroup.controllers").is_file()
    group = (CONTROLLERS if second else CONTROLLERS / "cpu") / f"follower-{os.getpid()}"
    quota_us = round(share * period_us)
    try:
        if second:
            (CONTROLLERS / "cgroup.subtree_control").write_text("+cpu")
        group.mkdir()
        if second:
            (group / "cpu.max").write_text(f"{quota_us} {period_us}")
            (group / "cpu.weight").write_text("10000")
        else:
            (group / "cpu.cfs_period_us").write_text(str(period_us))
            (group / "cpu.cfs_quota_us").write_text(str(quota_us))
            (group / "cpu.shares").write_text("262144")
    except OSError as error:
        sys.exit(f"small_board: no quota can be set here ({error}); run it as root on Linux")
    try:
        yield group / "cgroup.procs"
    finally:
        with suppress(OSError):
            group.rmdir()


def write_film(clip: BenchClip, seconds: float, path: Path) -> None:
    """Write the clip, forwards and backwards, as H.264."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=CAMERA_HZ, options={"preset": "ultrafast"})
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for number in range(round(seconds * CAMERA_HZ)):
            picture = clip.decoded(clip.index(number))
            frame = av.VideoFrame.from_ndarray(np.asarray(picture), format="bgr24")
            frame.pts, frame.time_base = number, Fraction(1, CAMERA_HZ)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


class Watcher:
    """Counts the pictures that come by RTP: their last packets carry the marker."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self.address = "127.0.0.1:{1}".format(*self._socket.getsockname())
        self.pictures = 0
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        while packet := self._socket.recv(2048):
            self.pictures += packet[1] >> 7


def fly(
    share: float, period_us: int, seconds: float, film: Path, clip: BenchClip, folder: Path
) -> Figures:
    """Fly with that share of a core."""
    ours, theirs = UdpTransport.pair()
    port = ours.port
    ours.close()
    clock, watcher = MonotonicClock(), Watcher()
    autopilot = SimAutopilot("ardupilot", theirs, BodyState(0.0, (0.0, 0.0, -20.0)))
    x, y, width, height = clip.boxes[0].xywh
    target = ("--target", f"{x:.0f},{y:.0f},{width:.0f},{height:.0f}")
    place = ("--connect", f"udpin:127.0.0.1:{port}", "--camera", str(film), "--out", str(folder))
    skipped = [word for name in SKIPPED for word in ("--skip-preflight", name)]
    settings = [word for one in SETTINGS for word in ("--set", one)]
    with autopilot_thread(autopilot, clock), quota(share, period_us) as members:
        program = subprocess.Popen(
            [
                *FOLLOWER,
                *place,
                *target,
                *skipped,
                *settings,
                "--set",
                f"video.udp={watcher.address}",
            ],
            preexec_fn=lambda: members.write_text(str(os.getpid())),
            env={**os.environ, "PYTHONUNBUFFERED": "1", "COLUMNS": "200"},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        try:
            _wait_for(program, "switch to GUIDED")
            autopilot.switch_mode("GUIDED")
            time.sleep(1.0)
            before = watcher.pictures
            time.sleep(seconds)
            seen = watcher.pictures - before
            program.send_signal(signal.SIGINT)
            program.wait(PATIENCE_S)
        finally:
            program.kill()
            program.wait()
    theirs.close()
    return figures(folder / "fly", seen / seconds)


def _wait_for(program: subprocess.Popen[str], words: str) -> None:
    """Wait until the program has said this, then read on and forget what it says."""
    assert program.stdout is not None
    said: list[str] = []
    for line in program.stdout:
        said.append(line)
        if words in line:
            break
    else:
        sys.exit("".join(said))
    threading.Thread(target=program.stdout.read, daemon=True).start()


def figures(folder: Path, people: float) -> Figures:
    """Read from the recording what happened while it followed."""
    flight = open_flight(folder)
    steps = [one for one in flight.log.controls if one.state is SupervisorState.FOLLOWING]
    if not steps:
        sys.exit(f"small_board: {folder} never followed")
    began_s, ended_s = steps[0].time_s, steps[-1].time_s
    late = 1e3 * np.array([one.late_s for one in steps])
    tracks = [one for one in flight.log.tracks if began_s <= one.done_s <= ended_s]
    told = " ".join(event.text for event in flight.log.events)
    missing = re.search(r"(\d+) frames are not in the video", told)
    return Figures(
        float(np.median(late)),
        float(np.percentile(late, 99)),
        len(steps) / (ended_s - began_s),
        len(tracks) / (ended_s - began_s),
        int(missing[1]) if missing else 0,
        people,
    )


def main() -> None:
    """Measure and print."""
    parser = command_line.parser(__doc__)
    parser.add_argument("seconds", nargs="?", type=command_line.positive, default=20.0)
    parser.add_argument("period_ms", nargs="?", type=command_line.positive, default=20.0)
    options = parser.parse_args()
    seconds, period_ms = options.seconds, options.period_ms
    clips = render_clips((SIZE,), PICTURES)
    assert clips is not None
    with tempfile.TemporaryDirectory() as name:
        film = Path(name) / "film.mp4"
        write_film(clips[SIZE], 60.0 + seconds, film)
        head = (
            "core",
            "late p50",
            "p99 ms",
            "control Hz",
            "vision Hz",
            "missing",
            "people Hz",
            "load",
        )
        print("".join(f"{word:>11}" for word in head))
        for share in SHARES:
            folder = Path(name) / str(share)
            row = fly(share, round(1e3 * period_ms), seconds, film, clips[SIZE], folder)
            load = os.getloadavg()[0]
            print("".join(f"{number:11.2f}" for number in (share, *row, load)), flush=True)


if __name__ == "__main__":
    command_line.run(main)
