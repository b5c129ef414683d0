"""Whether the control loop keeps its 50 Hz while vision saturates a core.

    python benchmarks/control_jitter.py [SECONDS]

The threads are those of a flight: capture, vision, control, and a simulated autopilot reached by
UDP. Vision runs the correlation tracker on 1280x720 frames that come faster than it can answer, so
that it never rests. Measured is how late each control step begins, and how far the time between
two steps is from 20 ms; the first second is left out.
"""

from __future__ import annotations

import sys
import threading
from contextlib import closing

import cv2
import numpy as np

from follower.flight.control.loop import ControlLoop
from follower.flight.control.stage import ControlStage
from follower.flight.log import FlightLog
from follower.flight.target.selectors import box_selector
from follower.flight.threads import RealtimeRun, VisionLoop
from follower.flight.vision.stage import VisionStage
from follower.flight.vision.tracker_factory import make_target_tracker
from follower.links.connections import open_connection
from follower.links.pymavlink_link import MavlinkLink
from follower.settings.settings import Settings
from follower_sim.autopilot.autopilot import SimAutopilot, run_autopilot
from follower_sim.kinematics import BodyState
from follower_vision.clock import Clock, MonotonicClock
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import ClosesItself

WIDTH, HEIGHT, CAMERA_HZ = 1280, 720, 400.0
ADDRESS = "127.0.0.1:14593"


class FastCamera(ClosesItself):
    """Gives a textured picture that drifts, faster than anybody can track it."""

    nominal_rate_hz = CAMERA_HZ
    frame_count: int | None = None
    problem: str | None = None

    def __init__(self, clock: Clock, seed: int) -> None:
        rng = np.random.default_rng(seed)
        small = rng.integers(0, 255, (HEIGHT // 12, WIDTH // 12, 3), dtype=np.uint8)
        self._ground = cv2.resize(small, (WIDTH + 64, HEIGHT + 64), interpolation=cv2.INTER_CUBIC)
        self._clock = clock
        self._sequence = 0

    def read(self) -> Frame:
        """Return the next picture."""
        self._sequence += 1
        self._clock.sleep_until(self._sequence / CAMERA_HZ)
        shift = self._sequence // 20 % 64
        image = np.ascontiguousarray(self._ground[shift : shift + HEIGHT, shift : shift + WIDTH])
        return Frame(image, self._clock.now(), self._sequence)

    def close(self) -> None:
        """Nothing is held."""


def main() -> None:
    """Measure and print."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 20.0
    settings, log, clock = Settings(), FlightLog(), MonotonicClock()
    with (
        closing(open_connection(f"udpin:{ADDRESS}")) as ours,
        closing(open_connection(f"udpout:{ADDRESS}")) as theirs,
    ):
        hovering = BodyState(0.0, (0.0, 0.0, -20.0))
        autopilot = SimAutopilot("ardupilot", theirs, hovering)
        autopilot.switch_mode("GUIDED")
        stop = threading.Event()
        thread = threading.Thread(target=run_autopilot, args=(autopilot, clock, stop))
        thread.start()
        stage = VisionStage(make_target_tracker(settings))
        stage.select(box_selector(Box(640.0, 360.0, 80.0, 60.0)))
        vision = VisionLoop(stage, clock, log)
        control_stage = ControlStage(settings, settings.camera.model(WIDTH, HEIGHT), log)
        control = ControlLoop(MavlinkLink(ours), control_stage, lambda: vision.tracks.newest, log)
        run = RealtimeRun(clock, FastCamera(clock, 1), vision, control, settings.control_rate_hz)
        run.run(lambda: clock.now() < seconds + 1.0)
        stop.set()
        thread.join()
    report(log, seconds)


def report(log: FlightLog, seconds: float) -> None:
    """Print what was measured."""
    controls = [record for record in log.controls if record.time_s > 1.0]
    times = np.array([record.time_s for record in controls])
    tracks = [record for record in log.tracks if record.done_s > 1.0]
    busy = sum(record.busy_s for record in tracks) / seconds
    print(f"{len(controls)} control steps in {seconds:.0f} s, vision busy {100 * busy:.0f} % of it")
    print(f"frames tracked: {len(tracks)}, {len(tracks) / seconds:.0f} a second")
    print(f"{'ms':26}{'median':>9}{'p99':>9}{'max':>9}")
    rows = (
        ("step begins late by", np.array([record.late_s for record in controls])),
        ("period off 20 ms by", np.abs(np.diff(times) - 0.02)),
        ("step takes", np.array([record.busy_s for record in controls])),
    )
    for name, values in rows:
        ms = 1e3 * values
        print(f"{name:26}{np.median(ms):9.3f}{np.percentile(ms, 99):9.3f}{ms.max():9.3f}")


if __name__ == "__main__":
    main()
