"""What recording costs: processor time, and the control loop's punctuality.

    python benchmarks/recorder.py [ROUNDS] [SECONDS]

A flight's threads run in real time: a camera of 1280x720 at 30 frames a second, vision with the
correlation tracker, control at 50 Hz, a simulated autopilot reached by UDP. Each round flies
SECONDS with recording and as long without, in turn, in one process: what else the machine does
meets both alike. Frames are a textured picture with a camera's noise.

On a machine that others use, run it by `chrt -f 5 python …`: the flight's threads then come before
all else, and the recorder's, which give way to them, before what others run, as on a machine of
one's own.

The first table is the recorder's processor time by thread, as the kernel counts it, as a share of
one core. "Encoder" is x264 alone, fed with the same pictures, already converted. The second is when
a control step began and ended, after its due time.
"""

from __future__ import annotations

import os
import tempfile
import threading
import time
from contextlib import closing
from fractions import Fraction
from pathlib import Path

import av
import command_line
import cv2
import numpy as np
import numpy.typing as npt
from rich.progress import track as progress

from follower.flight.control.loop import ControlLoop
from follower.flight.control.stage import ControlStage
from follower.flight.log import ControlRecord, FlightLog
from follower.flight.target.selectors import box_selector
from follower.flight.threads import RealtimeRun, VisionLoop
from follower.flight.vision.stage import VisionStage
from follower.flight.vision.tracker_factory import make_target_tracker
from follower.links.connections import open_connection
from follower.links.pymavlink_link import MavlinkLink
from follower.recording import FlightConfig, Recorder, epoch_now_ns, recorder, video_writer
from follower.recording.video_writer import MatroskaWriter, to_picture
from follower.settings.recorder import RecorderSettings
from follower.settings.settings import Settings
from follower_control.common.transport import Transport
from follower_sim.autopilot.autopilot import SimAutopilot, autopilot_thread
from follower_sim.kinematics import BodyState
from follower_vision.clock import Clock, MonotonicClock
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import ClosesItself

WIDTH, HEIGHT, CAMERA_HZ = 1280, 720, 30.0
ADDRESS = "127.0.0.1:14595"
PICTURES = 60
Array = npt.NDArray[np.float64]


class Camera(ClosesItself):
    """Gives noisy pictures of a ground that drifts, made beforehand."""

    nominal_rate_hz = CAMERA_HZ
    frame_count: int | None = None
    problem: str | None = None

    def __init__(self, clock: Clock, images: list[npt.NDArray[np.uint8]]) -> None:
        self._clock = clock
        self._images = images
        self._began_s = clock.now()
        self._sequence = 0

    def read(self) -> Frame:
        """Wait for the next picture."""
        self._sequence += 1
        self._clock.sleep_until(self._began_s + self._sequence / CAMERA_HZ)
        image = self._images[self._sequence % len(self._images)]
        return Frame(image, self._clock.now(), self._sequence)

    def close(self) -> None:
        """Nothing is held."""


def pictures(seed: int) -> list[npt.NDArray[np.uint8]]:
    """Make the camera's pictures."""
    rng = np.random.default_rng(seed)
    small = rng.integers(60, 200, (HEIGHT // 12, WIDTH // 12 + 12, 3), dtype=np.uint8)
    ground = cv2.resize(small, (WIDTH + 144, HEIGHT), interpolation=cv2.INTER_CUBIC)
    images = []
    for number in range(PICTURES):
        shift = number if number < PICTURES // 2 else PICTURES - number
        noise = rng.normal(0, 2.5, (HEIGHT, WIDTH, 3)).astype(np.int16)
        image = np.clip(ground[:, shift : shift + WIDTH] + noise, 0, 255).astype(np.uint8)
        images.append(image)
    return images


def fly(
    seconds: float, images: list[npt.NDArray[np.uint8]], folder: Path | None, ends: list[Transport]
) -> tuple[list[ControlRecord], dict[str, float]]:
    """Fly, recorded into the folder if there is one; return the steps and threads' seconds."""
    settings, clock = Settings(), MonotonicClock()
    ours, theirs = ends
    recording = None
    if folder is not None:
        config = FlightConfig.of("real", settings, epoch_ns=epoch_now_ns(clock))
        recording = Recorder(folder, config, clock, RecorderSettings(keep_free_mb=0))
    log = FlightLog() if recording is None else recording.log
    link = MavlinkLink(ours if recording is None else recording.transport(ours))
    autopilot = SimAutopilot("ardupilot", theirs, BodyState(0.0, (0.0, 0.0, -20.0)))
    autopilot.switch_mode("GUIDED")
    stage = VisionStage(make_target_tracker(settings))
    stage.select(box_selector(Box(640.0, 360.0, 80.0, 60.0)))
    vision = VisionLoop(stage, clock, log)
    control_stage = ControlStage(settings, settings.camera.model(WIDTH, HEIGHT), log)
    control = ControlLoop(link, control_stage, lambda: vision.tracks.newest, log)
    run = RealtimeRun(clock, Camera(clock, images), vision, control, settings.control_rate_hz)
    with autopilot_thread(autopilot, clock):
        run.run(lambda: clock.now() < seconds + 1.0)
        spent = {name: spent_s(name) for name in ("video", "recorder")}
    if recording is not None:
        recording.close()
        print(*recording.remarks, sep="\n", end="")
    return [record for record in log.controls if record.time_s > 1.0], spent


def spent_s(name: str) -> float:
    """Return the processor time of the thread of that name, 0 if there is none."""
    for thread in threading.enumerate():
        if thread.name == name and thread.ident is not None:
            return time.clock_gettime(time.pthread_getcpuclockid(thread.ident))
    return 0.0


def encoder_share(images: list[npt.NDArray[np.uint8]]) -> float:
    """Return x264's own share of a core at the camera's rate, with pictures in its format."""
    ready = [to_picture(image, lossless=False) for image in images]
    options = {"preset": "ultrafast", "tune": "zerolatency", "g": "30", "crf": "23"}
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt = WIDTH, HEIGHT, "yuv420p"
    codec.time_base, codec.options, codec.thread_count = Fraction(1, 1000), options, 1
    codec.open()
    began = time.thread_time()
    for number in range(150):
        picture = ready[number % len(ready)]
        picture.pts = number * 33
        codec.encode(picture)
    return (time.thread_time() - began) / 150 * CAMERA_HZ


def whole_video_share(images: list[npt.NDArray[np.uint8]], folder: Path) -> float:
    """Return the share of a core of conversion, x264 and writing together."""
    with MatroskaWriter(folder / "alone.mkv", RecorderSettings()) as video:
        began = time.thread_time()
        for number in range(150):
            video.write(Frame(images[number % len(images)], number / CAMERA_HZ, number))
        return (time.thread_time() - began) / 150 * CAMERA_HZ


def handing_over_share(recorded: list[ControlRecord]) -> float:
    """Return the share of a core that the flight's own threads spend on handing over."""
    frame = Frame(np.zeros((HEIGHT, WIDTH, 3), np.uint8), 0.0, 0)
    with tempfile.TemporaryDirectory() as name:
        config = FlightConfig.of("real", Settings())
        with Recorder(Path(name), config, MonotonicClock()) as recording:
            began = time.thread_time()
            for record in recorded[:100]:
                recording.add(record, record.time_s)
            for _ in range(20):
                recording.add_frame(frame, 0.0)
            spent = time.thread_time() - began
    # A hundred control steps and twenty frames: about 1.4 s of flight.
    return spent / 2.0


def give_way_to_the_flight_alone() -> None:
    """Stand in for the recorder's own `give_way` under `chrt -f`."""
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))


def main() -> None:
    """Measure and print."""
    if os.sched_getscheduler(0) == os.SCHED_FIFO:
        for module in (recorder, video_writer):
            vars(module)["give_way"] = give_way_to_the_flight_alone
    parser = command_line.parser(__doc__)
    parser.add_argument("rounds", nargs="?", type=command_line.count, default=5)
    parser.add_argument("seconds", nargs="?", type=command_line.positive, default=10.0)
    options = parser.parse_args()
    rounds, seconds = options.rounds, options.seconds
    cv2.setNumThreads(1)
    images = pictures(1)
    controls: dict[bool, list[list[ControlRecord]]] = {True: [], False: []}
    shares: list[tuple[float, float]] = []
    with (
        closing(open_connection(f"udpin:{ADDRESS}")) as ours,
        closing(open_connection(f"udpout:{ADDRESS}")) as theirs,
        tempfile.TemporaryDirectory() as name,
    ):
        for number in progress(range(2 * rounds), "flights"):
            recorded = number % 2 == 0
            folder = Path(name) / str(number) if recorded else None
            if folder is not None:
                folder.mkdir()
            steps, spent = fly(seconds, images, folder, [ours, theirs])
            controls[recorded].append(steps)
            if recorded:
                shares.append((spent["video"] / (seconds + 1), spent["recorder"] / (seconds + 1)))
        report_cost(shares, images, controls[True][0], Path(name))
    report_punctuality(controls)


def report_cost(
    shares: list[tuple[float, float]],
    images: list[npt.NDArray[np.uint8]],
    recorded: list[ControlRecord],
    folder: Path,
) -> None:
    """Print the first table."""
    video, log = np.median(np.array(shares), axis=0)
    encoder, alone = encoder_share(images), whole_video_share(images, folder)
    handing = handing_over_share(recorded)
    print(f"{'% of a core':34}{'median':>9}")
    rows = (
        ("thread of the log", log),
        ("thread of the video, in flight", video),
        ("the same alone, nothing else runs", alone),
        ("of that the encoder", encoder),
        ("handing over, in the flight", handing),
        ("beyond the encoder", log + max(video, alone) - encoder + handing),
    )
    for label, share in rows:
        print(f"{label:34}{100 * share:9.2f}")


def report_punctuality(controls: dict[bool, list[list[ControlRecord]]]) -> None:
    """Print the second table: percentiles over all steps, and the spread of the rounds' p99."""
    print(f"\n{'ms':34}{'median':>9}{'p99':>9}{'max':>9}   p99 of each round")
    for recorded, rounds in controls.items():
        for label, values in (("begins", _begins), ("ends", _ends)):
            name = f"{'with' if recorded else 'without'} recording, a step {label}"
            every = 1e3 * values([record for one in rounds for record in one])
            each = [float(np.percentile(1e3 * values(one), 99)) for one in rounds]
            spread = " ".join(f"{value:.2f}" for value in sorted(each))
            print(
                f"{name:34}{np.median(every):9.3f}{np.percentile(every, 99):9.3f}"
                f"{every.max():9.2f}   {spread}"
            )


def _begins(records: list[ControlRecord]) -> Array:
    return np.array([record.late_s for record in records])


def _ends(records: list[ControlRecord]) -> Array:
    return np.array([record.late_s + record.busy_s for record in records])


if __name__ == "__main__":
    command_line.run(main)
