"""A simulated autopilot behind a real UDP port, and a video that stands for a camera."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

from follower.simulation.faults.wire_tap import FlightEvidence, WireSetpoint, WireTap
from follower_control.common.transport import UdpTransport
from follower_sim.autopilot.autopilot import SimAutopilot
from follower_sim.kinematics import BodyState
from follower_vision.clock import MonotonicClock

WIDTH, HEIGHT, RATE_HZ = 320, 240, 30
PATIENT = ("supervisor.telemetry_timeout_s=20", "supervisor.alone_s=20")
"""Settings for flights whose vehicle lives in the test's process, which a loaded computer may stop
for longer than a link may be silent; how long that is, other tests say."""


class Vehicle:
    """A simulated autopilot that runs by itself and speaks to a port of this computer."""

    def __init__(self, flavour: str, port: int, height_m: float = 0.0) -> None:
        self.clock = MonotonicClock()
        self.wire = WireTap(UdpTransport.connect("127.0.0.1", port), self.clock)
        self._watched = FlightEvidence(flavour)
        start = BodyState(self.clock.now(), (0.0, 0.0, -height_m))
        self.autopilot = SimAutopilot(flavour, self.wire, start)
        self.setpoint_mode = "OFFBOARD" if flavour == "px4" else "GUIDED"
        self.each_step: Callable[[float], None] = lambda _: None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.is_set():
            now_s = self.clock.now()
            self.each_step(now_s)
            self.autopilot.step(now_s)
            self._watched.watch(self.autopilot, now_s)
            time.sleep(0.004)

    @property
    def evidence(self) -> FlightEvidence:
        """What the follower sent until now, and how the vehicle moved."""
        evidence = replace(self._watched, motion=list(self._watched.motion), setpoints=[])
        evidence.read(list(self.wire.received), list(self.wire.sent))
        return evidence

    @property
    def setpoints(self) -> list[WireSetpoint]:
        return self.evidence.setpoints

    @property
    def turns(self) -> bool:
        """Whether it was told to turn right."""
        return any(s.values[3] > 0.05 for s in self.setpoints)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.wire.close()


@contextmanager
def flying_vehicle(flavour: str, port: int, height_m: float = 0.0) -> Iterator[Vehicle]:
    vehicle = Vehicle(flavour, port, height_m)
    try:
        yield vehicle
    finally:
        vehicle.close()


def write_square(path: Path, seconds: float) -> Path:
    """Write a video of a red square, right of the centre, on a ground that trembles."""
    rng = np.random.default_rng(5)
    coarse = rng.integers(60, 180, (24, 32), dtype=np.uint8)
    grey = cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_LINEAR)
    ground = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=RATE_HZ, options={"preset": "ultrafast"})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for number in range(round(seconds * RATE_HZ)):
            image = ground.copy()
            x = 190 + round(6 * np.sin(number / 20))
            cv2.rectangle(image, (x, 100), (x + 39, 139), (32, 32, 208), -1)
            cv2.rectangle(image, (x + 8, 108), (x + 24, 120), (200, 200, 40), -1)
            image = cv2.add(image, rng.integers(0, 6, image.shape, dtype=np.uint8))
            frame = av.VideoFrame.from_ndarray(image, format="bgr24")
            frame.pts, frame.time_base = number, Fraction(1, RATE_HZ)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path
