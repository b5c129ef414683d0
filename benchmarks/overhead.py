"""What our own code costs between a frame and a setpoint, the motion tracker left out.

    python benchmarks/overhead.py

A generated 1280x720 video (a patch that moves over a textured ground) goes through the same stages
as in flight, on one thread. The motion tracker is timed by itself and taken away from the vision
stage's time; added to it is one control step with telemetry. What the tracker learns from a frame
after it has answered is listed by itself. Promise: median and mean are below 1 ms.
"""

from __future__ import annotations

import math
import time

import cv2
import numpy as np

from follower.flight.control.stage import ControlStage
from follower.flight.log import FlightLog, TrackRecord
from follower.flight.vision.stage import VisionStage
from follower.settings.settings import Settings
from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.longterm.tracker import LongTermTracker
from follower_vision.trackers.correlation import CorrelationTracker
from follower_vision.trackers.motion_tracker import MotionEstimate

WIDTH, HEIGHT, FRAMES, RATE_HZ = 1280, 720, 600, 30.0
TARGET_PX = 60


class Timed:
    """A motion tracker that adds up its own time."""

    name = "timed"

    def __init__(self) -> None:
        self._tracker = CorrelationTracker()
        self.busy_s = 0.0

    def start(self, image: Image, box: Box) -> None:
        """Start the tracker."""
        began = time.perf_counter()
        self._tracker.start(image, box)
        self.busy_s += time.perf_counter() - began

    def update(self, image: Image) -> MotionEstimate:
        """Update the tracker."""
        began = time.perf_counter()
        estimate = self._tracker.update(image)
        self.busy_s += time.perf_counter() - began
        return estimate


def texture(rng: np.random.Generator, width: int, height: int, coarse: int) -> Image:
    """Return smooth random colours, (height, width, 3)."""
    small = rng.integers(0, 255, (height // coarse + 2, width // coarse + 2, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC), np.uint8)


def frames(rng: np.random.Generator) -> list[tuple[Frame, Box]]:
    """Return the video, and where the patch is: for choosing it in the first frame alone."""
    ground = texture(rng, WIDTH + 200, HEIGHT + 200, 24)
    patch = texture(rng, TARGET_PX, TARGET_PX, 12)
    video = []
    for number in range(FRAMES):
        phase = 2 * math.pi * number / 200
        image = ground[100:, 100:][:HEIGHT, :WIDTH].copy()
        x, y = round(600 + 300 * math.sin(phase)), round(330 + 150 * math.cos(phase))
        image[y : y + TARGET_PX, x : x + TARGET_PX] = patch
        # A camera never gives the same picture twice.
        image[:, :, number % 3] ^= rng.integers(0, 2, (HEIGHT, WIDTH), dtype=np.uint8)
        box = Box.from_xywh(x, y, TARGET_PX, TARGET_PX)
        video.append((Frame(image, number / RATE_HZ, number), box))
    return video


def main() -> None:
    """Measure and print."""
    cv2.setNumThreads(1)
    video = frames(np.random.default_rng(1))
    motion, log = Timed(), FlightLog()
    settings = Settings()
    vision = VisionStage(LongTermTracker(motion, settings.longterm))
    vision.select(lambda _frame: video[0][1])
    control = ControlStage(settings, settings.camera.model(WIDTH, HEIGHT), log)
    vision_ms, control_ms, learning_ms = [], [], []
    for frame, _ in video:
        tracker_before, began = motion.busy_s, time.perf_counter()
        track = vision.step(frame)
        spent = time.perf_counter() - began - (motion.busy_s - tracker_before)
        now = frame.captured_s + 0.03
        record = TrackRecord(track, frame.sequence, frame.captured_s, now, now, 0.0)
        attitude = Attitude(0.0, 0.05, 0.1 * now, 0.0, 0.0, 0.1, now - 0.005)
        position = LocalPosition(now - 0.01, 0.0, -10.0, 1.0, 0.0, 0.0, now - 0.01)
        state = VehicleState(attitude, position, "GUIDED", True, True, False, now)
        began = time.perf_counter()
        control.step(now, record, state, [attitude])
        vision_ms.append(1e3 * spent)
        control_ms.append(1e3 * (time.perf_counter() - began))
        began = time.perf_counter()
        vision.learn()
        learning_ms.append(1e3 * (time.perf_counter() - began))
    total = np.array(vision_ms) + np.array(control_ms)
    following = sum(record.state == "following" for record in log.controls)
    print(f"{FRAMES} frames of {WIDTH}x{HEIGHT}, following in {following} of them")
    print(f"{'':28}{'median':>9}{'mean':>9}{'p99':>9}{'max':>9}  ms")
    rows = (
        ("vision, tracker left out", np.array(vision_ms)),
        ("control step", np.array(control_ms)),
        ("between frame and setpoint", total),
        ("learning, afterwards", np.array(learning_ms)),
    )
    for name, values in rows:
        print(
            f"{name:28}{np.median(values):9.3f}{values.mean():9.3f}"
            f"{np.percentile(values, 99):9.3f}{values.max():9.3f}"
        )
    print(f"motion tracker alone: {1e3 * motion.busy_s / FRAMES:.2f} ms a frame")


if __name__ == "__main__":
    main()
