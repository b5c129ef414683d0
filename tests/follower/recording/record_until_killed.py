"""Records a flight in real time until it is killed: a program that the tests start.

    python record_until_killed.py FOLDER VIDEO [RATE_HZ]

Prints after each control step by how many seconds this computer has been too late for a thread of
the recorder's priority that writes to the same disk, and the flight's time: so whoever kills it
knows how far it was, and what could be on the disk.
"""

import os
import sys
import threading
import time
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from follower.flight.control.stage import ControlStage
from follower.recording import FlightConfig, Recorder, RecorderSettings, VideoKind, epoch_now_ns
from follower.recording.video_writer import give_way
from follower.settings.settings import Settings
from follower_control.common.transport import MemoryTransport
from follower_control.vehicle.state import VehicleState
from follower_vision.clock import MonotonicClock
from follower_vision.images.frame import Frame

PROBE_S = 0.05


def main() -> None:
    folder, video = Path(sys.argv[1]), VideoKind(sys.argv[2])
    seconds = float(sys.argv[3]) if len(sys.argv) > 3 else 600.0
    settings, clock = Settings(), MonotonicClock()
    config = FlightConfig.of("real", settings, epoch_ns=epoch_now_ns(clock))
    wanted = RecorderSettings(video=video, keep_free_mb=0)
    noise = np.random.default_rng(1).integers(0, 255, (300, 400, 3), dtype=np.uint8)
    lateness = Lateness(folder)
    with Recorder(folder, config, clock, wanted) as recorder:
        link = recorder.transport(MemoryTransport.pair()[0])
        codec = mavlink.MAVLink(None, 1, 191)
        control = ControlStage(settings, settings.camera.model(320, 240), recorder.log)
        threading.Thread(target=capture, args=(recorder, clock, noise), daemon=True).start()
        while clock.now() < seconds:
            clock.sleep_until(clock.now() + 0.02)
            now_s = clock.now()
            control.step(now_s, None, VehicleState(heartbeat_s=now_s))
            link.send(mavlink.MAVLink_system_time_message(1, round(1000 * now_s)).pack(codec))
            print(f"{lateness.longest_s:.4f} {now_s:.4f}", flush=True)
    print(*recorder.remarks, sep="\n", file=sys.stderr, flush=True)


class Lateness:
    """Measures by how much a thread like the recorder's, that sleeps and writes, is too late."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "probe"
        self._longest_s, self._began_s = 0.0, time.monotonic()
        threading.Thread(target=self._measure, daemon=True).start()

    @property
    def longest_s(self) -> float:
        return max(self._longest_s, time.monotonic() - self._began_s - PROBE_S)

    def _measure(self) -> None:
        give_way()
        with self._path.open("wb") as file:
            while True:
                self._began_s = time.monotonic()
                time.sleep(PROBE_S)
                os.pwrite(file.fileno(), b"x", 0)
                os.fdatasync(file.fileno())
                self._longest_s = self.longest_s


def capture(recorder: Recorder, clock: MonotonicClock, noise: np.ndarray) -> None:
    for number in range(1_000_000):
        clock.sleep_until(number / 30)
        shift = number % 50
        image = np.ascontiguousarray(noise[shift : shift + 240, shift : shift + 320])
        now_s = clock.now()
        recorder.add_frame(Frame(image, now_s, number), now_s)


if __name__ == "__main__":
    main()
