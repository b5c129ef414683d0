"""Measures one set-up with the threads of a flight."""

import logging
import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from follower.apps.bench.result import BenchRow, BenchSetup
from follower.apps.bench.scene import BenchCamera, BenchClip
from follower.apps.preflight.computer_checks import temperature_c, throttled
from follower.flight.control.loop import ControlLoop
from follower.flight.control.stage import ControlStage
from follower.flight.log import ControlRecord, FlightLog, TrackRecord
from follower.flight.supervision.supervisor import SupervisorState
from follower.flight.target.selectors import box_selector
from follower.flight.threads import RealtimeRun, VisionLoop
from follower.flight.vision.stage import VisionStage
from follower.flight.vision.tracker_factory import close_tracker, make_target_tracker
from follower.links.pymavlink_link import MavlinkLink
from follower.recording import FlightConfig, Recorder, epoch_now_ns
from follower.settings.link import LinkSettings
from follower.settings.recorder import RecorderSettings, VideoKind
from follower.settings.settings import Settings, VisionSettings
from follower_control.common.transport import UdpTransport
from follower_sim.autopilot.autopilot import SimAutopilot, autopilot_thread
from follower_sim.kinematics import BodyState
from follower_vision import onnx_network
from follower_vision.clock import MonotonicClock
from follower_vision.fusion import BackgroundDetection
from follower_vision.onnx_network import ModelError
from follower_vision.trackers.track import TrackState

WARM_S = 0.5
"""Left out at the beginning: the target is chosen, memory is taken, caches are cold."""
_LONGEST_WARM_S = 4.0
"""And until it follows, but no longer than this."""
_LEAST_FRAMES, _PATIENCE_S = 4, 15.0
"""So many are waited for, for so long."""
_OVERLAP = 0.3
_HEIGHT_M = 20.0


class NotMeasuredError(ValueError):
    """A set-up gives no figures here; the message is one line that says which and why."""


def measure(
    setup: BenchSetup,
    clip: BenchClip,
    seconds: float,
    folder: Path,
    go_on: Callable[[], bool] = lambda: True,
    camera_type: type[BenchCamera] = BenchCamera,
) -> BenchRow | None:
    """Fly a set-up for some seconds and return its figures; None once `go_on` said no.

    Capture decodes, vision tracks, control steps at its rate and sends setpoints by UDP to a
    simulated autopilot, and the recorder writes, each on its own thread as in a flight.

    Args:
        setup: is flown.
        clip: of its size.
        seconds: to measure, after `WARM_S` and from when it follows.
        folder: in which it is recorded, for as long as it takes.
        go_on: is asked ten times a second.
        camera_type: shows the clip.

    Raises:
        NotMeasuredError: a network is not there or not on this device, or no frame was answered.
    """
    settings = _settings(setup)
    with ExitStack() as stack:
        refusals = stack.enter_context(_refusals())
        try:
            tracker = make_target_tracker(settings, BackgroundDetection)
        except ModelError as error:
            raise NotMeasuredError(f"{setup.name}: {error}") from None
        stack.callback(close_tracker, tracker)
        place = Path(stack.enter_context(TemporaryDirectory(dir=folder)))
        ours, theirs = (stack.enter_context(closing(end)) for end in UdpTransport.pair())
        clock = MonotonicClock()
        config = FlightConfig.of("real", settings, epoch_ns=epoch_now_ns(clock))
        recorder = stack.enter_context(Recorder(place, config, clock, settings.recorder))
        link = MavlinkLink(recorder.transport(ours), settings.link)
        hovering = BodyState(0.0, (0.0, 0.0, -_HEIGHT_M))
        autopilot = SimAutopilot("ardupilot", theirs, hovering)
        stack.enter_context(autopilot_thread(autopilot, clock))
        camera = camera_type(clip, clock, setup.camera_hz)
        stage = VisionStage(tracker)
        stage.select(box_selector(clip.boxes[0]))
        vision = VisionLoop(stage, clock, recorder.log, on_record=camera.answered)
        control_stage = ControlStage(settings, settings.camera.model(*clip.size), recorder.log)
        stage.prospects = control_stage.prospect
        control = ControlLoop(
            link, control_stage, lambda: vision.tracks.newest, recorder.log, clock=clock
        )
        run = RealtimeRun(clock, camera, vision, control, settings.control_rate_hz)
        window = _Window(recorder.log, clock, seconds, go_on, autopilot, camera)
        run.run(window.goes_on)
    if refusals:
        raise NotMeasuredError(f"{setup.name}: {refusals[0]}")
    if window.ended:
        return None
    return _row(setup, clip, window, 1 / settings.control_rate_hz)


@dataclass(slots=True)
class _Window:
    """The time that is measured."""

    log: FlightLog
    clock: MonotonicClock
    seconds: float
    go_on: Callable[[], bool]
    autopilot: SimAutopilot
    camera: BenchCamera
    ended: bool = False
    began_s: float = math.inf
    _cpu: list[tuple[float, float]] = field(default_factory=list)

    def goes_on(self) -> bool:
        """Say whether there is more to measure; be the pilot, note the processor time spent."""
        now_s = self.clock.now()
        state = self.log.controls[-1].state if self.log.controls else SupervisorState.IDLE
        if state is SupervisorState.READY:
            self.autopilot.switch_mode("GUIDED")
        follows = state is SupervisorState.FOLLOWING or now_s >= _LONGEST_WARM_S
        if follows and now_s >= WARM_S:
            self.began_s = min(self.began_s, now_s)
            self._cpu.append((now_s, time.process_time()))
        self.ended = not self.go_on()
        since_s = now_s - self.began_s
        enough = since_s >= self.seconds and len(self.tracks) >= _LEAST_FRAMES
        if self.ended or enough or since_s >= self.seconds + _PATIENCE_S:
            self.camera.close()
            return False
        return True

    @property
    def tracks(self) -> list[TrackRecord]:
        """Vision's answers in the window."""
        return [record for record in list(self.log.tracks) if record.done_s >= self.began_s]

    @property
    def controls(self) -> list[ControlRecord]:
        """The control steps in the window."""
        return [record for record in self.log.controls if record.time_s >= self.began_s]

    @property
    def cores(self) -> float:
        """Processor time over the time; 0 if it was looked at only once."""
        (began_s, before), (ended_s, after) = self._cpu[0], self._cpu[-1]
        return (after - before) / (ended_s - began_s) if ended_s > began_s else 0.0


def _row(setup: BenchSetup, clip: BenchClip, window: _Window, period_s: float) -> BenchRow:
    tracks, controls = window.tracks, window.controls
    delays = list(_delays_s(controls))
    if len(tracks) < _LEAST_FRAMES or not delays or not window.cores:
        raise NotMeasuredError(f"{setup.name}, {setup.size}: slower than can be measured in time")
    late = 1e3 * np.array([record.late_s for record in controls])
    off = 1e3 * np.abs(np.diff([record.time_s for record in controls]) - period_s)
    return BenchRow(
        **setup.model_dump(),
        frames=len(tracks),
        rate_hz=(len(tracks) - 1) / (tracks[-1].done_s - tracks[0].done_s),
        step_ms=1e3 * float(np.median([record.busy_s for record in tracks])),
        on_target=float(np.mean([_covers(record, clip) for record in tracks])),
        late_ms=float(np.median(late)),
        late_p99_ms=float(np.percentile(late, 99)),
        late_max_ms=float(late.max()),
        period_off_p99_ms=float(np.percentile(off, 99)),
        control_ms=1e3 * float(np.median([record.busy_s for record in controls])),
        delay_ms=1e3 * float(np.median(delays)),
        sent=float(np.mean([record.sent for record in controls])),
        cores=window.cores,
        temperature_c=temperature_c(),
        throttled=throttled(),
    )


def _covers(record: TrackRecord, clip: BenchClip) -> bool:
    track, box = record.track, clip.boxes[clip.index(record.sequence)]
    if track is None or track.state is not TrackState.TRACKING:
        return False
    return track.box.iou(box) > _OVERLAP


def _delays_s(controls: list[ControlRecord]) -> Iterator[float]:
    """Yield the time from each frame's capture to the end of the first step that used it."""
    for before, record in pairwise(controls):
        captured_s = record.track_captured_s
        if captured_s is not None and captured_s != before.track_captured_s:
            yield record.time_s + record.busy_s - captured_s


def _settings(setup: BenchSetup) -> Settings:
    video = VideoKind.H264 if setup.video else VideoKind.NONE
    return Settings(
        tracker=setup.tracker,
        detector=setup.detector,
        vision=VisionSettings(device=setup.device),
        recorder=RecorderSettings(video=video),
        link=LinkSettings(vehicle_id=1),
    )


@contextmanager
def _refusals() -> Iterator[list[str]]:
    """Collect why a network does not run where it should: it goes on with the processor."""
    heard: list[str] = []

    class Listener(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            heard.append(record.getMessage())

    logger, listener = logging.getLogger(onnx_network.__name__), Listener(logging.WARNING)
    logger.addHandler(listener)
    try:
        yield heard
    finally:
        logger.removeHandler(listener)
