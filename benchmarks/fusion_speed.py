"""How fast Fusion is beside its motion tracker alone, inline and in the background.

    python benchmarks/fusion_speed.py DATA [--tracker re3] [--cores 2,1] [--only NAME,NAME]
        [--frames N]

DATA holds `sequences` and `weights`. The frames are decoded and brought to 1280x720 beforehand;
every network has one thread. The motion tracker alone and both modes of Fusion take turns, a block
of frames each, so that other programs on the machine slow all of them down alike; how much of the
machine those took is printed. Measured: docs/explanation/fusion.md.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import command_line
import cv2
import numpy as np
from threadpoolctl import threadpool_limits

from follower_vision.detection.detection import Detection, Detector
from follower_vision.detection.onnx_detector import OnnxDetector
from follower_vision.fusion import BackgroundDetection, FusionTracker
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.models import ModelStore
from follower_vision.trackers.motion_tracker import MotionTracker
from follower_vision.trackers.registry import make_tracker

Answer = TypeVar("Answer")

RATE_HZ = 30.0
SIZE = (1280, 720)
DEFAULT = "mountainbike6,carchase2,building5,car16_1,group2_2,wakeboard7"
IDLE_S = 10.0


@dataclass
class Spent:
    """What one way of tracking took.

    Attributes:
        frame_s: of every frame.
        cpu_s: of all threads together.
        own_s: processor time of the thread that follows, which alone makes a frame wait.
        motion_s: of it, in the motion tracker.
        detections: how many.
        detecting_s: in the detector.
    """

    frame_s: list[float] = field(default_factory=list)
    cpu_s: float = 0.0
    own_s: float = 0.0
    motion_s: float = 0.0
    detections: int = 0
    detecting_s: float = 0.0

    @property
    def mean_s(self) -> float:
        """A frame's mean time."""
        return sum(self.frame_s) / len(self.frame_s)

    def add(self, other: Spent) -> None:
        """Add another recording's."""
        self.frame_s += other.frame_s
        self.cpu_s += other.cpu_s
        self.own_s += other.own_s
        self.motion_s += other.motion_s
        self.detections += other.detections
        self.detecting_s += other.detecting_s


def timed(tracker: MotionTracker, spent: Spent) -> MotionTracker:
    """Let a motion tracker add up its own time; it stays able to do what it is able to do."""
    for name in ("start", "update", "search", "learn"):
        if hasattr(tracker, name):
            setattr(tracker, name, _adding_up(getattr(tracker, name), spent))
    return tracker


def _adding_up(work: Callable[..., Answer], spent: Spent) -> Callable[..., Answer]:
    def added_up(*given: object) -> Answer:
        began, before_s = time.thread_time(), spent.motion_s
        answer = work(*given)
        spent.motion_s = before_s + time.thread_time() - began  # with what it called itself
        return answer

    return added_up


class TimedDetector:
    """A detector that adds up its own time."""

    def __init__(self, detector: Detector, spent: Spent) -> None:
        self._detector = detector
        self._spent = spent
        self.class_names = detector.class_names

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
        """Detect."""
        began = time.perf_counter()
        found = self._detector.detect(image, region)
        self._spent.detecting_s += time.perf_counter() - began
        self._spent.detections += 1
        return found


class Alone:
    """The motion tracker without Fusion."""

    def __init__(self, tracker: MotionTracker, frame: Frame, box: Box) -> None:
        self.spent = Spent()
        self._tracker = tracker
        tracker.start(frame.image, box)

    def run(self, frames: list[Frame]) -> None:
        """Follow through a block of frames."""
        _time(self.spent, lambda frame: self._tracker.update(frame.image), frames)

    def close(self) -> None:
        """Nothing to close."""


class Inline:
    """Fusion that detects in the step that asks for it."""

    def __init__(self, tracker: MotionTracker, detector: Detector, frame: Frame, box: Box) -> None:
        self.spent = Spent()
        self._fusion = FusionTracker(
            timed(tracker, self.spent), TimedDetector(detector, self.spent)
        )
        self._fusion.start(frame, box)

    def run(self, frames: list[Frame]) -> None:
        """Follow through a block of frames."""
        _time(self.spent, self._fusion.step, frames)

    def close(self) -> None:
        """Let go of Fusion's threads."""
        self._fusion.close()


class Background:
    """Fusion with a thread that detects."""

    def __init__(self, tracker: MotionTracker, detector: Detector, frame: Frame, box: Box) -> None:
        self.spent = Spent()
        self._fusion = FusionTracker(
            timed(tracker, self.spent),
            TimedDetector(detector, self.spent),
            mode=self._service,
        )
        self._fusion.start(frame, box)

    def _service(self, detector: Detector) -> BackgroundDetection:
        self._detection = BackgroundDetection(detector)
        return self._detection

    def run(self, frames: list[Frame]) -> None:
        """Follow through a block of frames; the thread may finish afterwards."""
        _time(self.spent, self._fusion.step, frames)
        began = time.process_time()
        self._detection.wait_idle(IDLE_S)
        self.spent.cpu_s += time.process_time() - began

    def close(self) -> None:
        """Let go of Fusion's threads."""
        self._fusion.close()


def main() -> None:
    """Measure and print."""
    options = _options()
    cv2.setNumThreads(1)
    threadpool_limits(1, user_api="blas")
    folders = list(_folders(options))
    if not folders:
        raise SystemExit(f"no sequence in {options.data / 'sequences'} is called {options.only}")
    for cores in (int(number) for number in options.cores.split(",")):
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(0, set(range(cores)))
        print(f"\n{cores} core(s), {len(folders)} sequences at {SIZE[0]}x{SIZE[1]}")
        print(HEAD)
        total: dict[str, Spent] = {}
        began_s, others_s = time.perf_counter(), _others_s()
        for folder in folders:
            spent = _measured(options, folder)
            _print(folder.name, spent)
            for name, one in spent.items():
                total.setdefault(name, Spent()).add(one)
        _print("all", total)
        share = (_others_s() - others_s) / (time.perf_counter() - began_s)
        print(f"other programs took {share:.2f} cores")


def _options() -> argparse.Namespace:
    parser = command_line.parser(__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("--cores", default="2,1")
    parser.add_argument("--only", default=DEFAULT, help="parts of the sequences' names")
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--block", type=int, default=20)
    parser.add_argument("--tracker", default="nanotrack-v3")
    return parser.parse_args()


def _folders(options: argparse.Namespace) -> Iterator[Path]:
    for folder in sorted((options.data / "sequences").iterdir()):
        if any(part in folder.name for part in options.only.split(",")):
            yield folder


def _measured(options: argparse.Namespace, folder: Path) -> dict[str, Spent]:
    frames, box = _frames(folder, options.frames)
    weights = options.data / "weights"
    trackers = [_tracker(options.tracker, weights) for _ in range(3)]
    detector = OnnxDetector(weights / "yolox_nano_bi.onnx")
    ways: dict[str, Alone | Inline | Background] = {
        "motion alone": Alone(trackers[0], frames[0], box),
        "inline": Inline(trackers[1], detector, frames[0], box),
        "background": Background(trackers[2], detector, frames[0], box),
    }
    for first in range(1, len(frames), options.block):
        for way in ways.values():
            way.run(frames[first : first + options.block])
    for way in ways.values():
        way.close()
    return {name: way.spent for name, way in ways.items()}


def _tracker(name: str, weights: Path) -> MotionTracker:
    return make_tracker(name, ModelStore(weights).file)


def _frames(folder: Path, most: int) -> tuple[list[Frame], Box]:
    frames = []
    for number, path in enumerate(sorted((folder / "img").iterdir())[:most]):
        image = np.asarray(cv2.imread(str(path)), np.uint8)
        scale = SIZE[0] / image.shape[1], SIZE[1] / image.shape[0]
        resized = image if scale == (1, 1) else np.asarray(cv2.resize(image, SIZE), np.uint8)
        frames.append(Frame(resized, number / RATE_HZ, number))
    first = (folder / "groundtruth.txt").read_text().split()[0]
    x, y, width, height = (float(value) for value in first.split(","))
    return frames, Box.from_xywh(x * scale[0], y * scale[1], width * scale[0], height * scale[1])


def _others_s() -> float:
    """Processor time that was not this program's since the machine started; 0 if unknown."""
    try:
        fields = Path("/proc/stat").read_text().split()[1:9]
    except OSError:
        return 0.0
    user, nice, system, _, _, hard, soft, stolen = (int(field) for field in fields)
    busy = user + nice + system + hard + soft + stolen
    return busy / os.sysconf("SC_CLK_TCK") - time.process_time()


def _time(spent: Spent, step: Callable[[Frame], object], frames: list[Frame]) -> None:
    began_cpu, began_own = time.process_time(), time.thread_time()
    for frame in frames:
        began = time.perf_counter()
        step(frame)
        spent.frame_s.append(time.perf_counter() - began)
    spent.own_s += time.thread_time() - began_own
    spent.cpu_s += time.process_time() - began_cpu


HEAD = (
    f"{'sequence':20} {'way':13} {'frames/s':>9} {'of alone':>9} {'median':>7} {'p99':>7}"
    f" {'max':>7} {'CPU':>6} {'own':>6} {'motion':>7}  ms;  detections a frame, ms each"
)


def _print(sequence: str, spent: dict[str, Spent]) -> None:
    alone_s = spent["motion alone"].mean_s
    for name, one in spent.items():
        count = len(one.frame_s)
        median, late, last = (1000 * float(np.percentile(one.frame_s, p)) for p in (50, 99, 100))
        detecting = ""
        if one.detections:
            each = 1000 * one.detecting_s / one.detections
            detecting = f"       {one.detections / count:.2f}, {each:.1f}"
        print(
            f"{sequence:20} {name:13} {1 / one.mean_s:9.1f} {alone_s / one.mean_s:9.2f}"
            f" {median:7.2f} {late:7.2f} {last:7.2f} {1000 * one.cpu_s / count:6.2f}"
            f" {1000 * one.own_s / count:6.2f} {1000 * one.motion_s / count:7.2f}{detecting}",
            flush=True,
        )


if __name__ == "__main__":
    command_line.run(main)
