"""Runs vision and control over a video and its telemetry, and records that as a flight."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import chain, pairwise

from follower.flightlog import FlightLog
from follower.realtime import VisionLoop
from follower.recorded import RecordedControl
from follower.settings import Settings
from follower.telemetry import TelemetryLog, TelemetryPlayback
from follower.tracking import make_target_tracker
from follower.vision_stage import Selector, VisionStage
from follower_vision.box import Box
from follower_vision.clock import SimulatedClock
from follower_vision.frame import Frame
from follower_vision.framesource import FrameSource

Progress = Callable[[Frame], None]


def run_import(
    source: FrameSource,
    settings: Settings,
    selector: Selector,
    telemetry: TelemetryLog | None,
    log: FlightLog,
    clock: SimulatedClock,
    progress: Progress,
) -> bool:
    """Go through the video to its end; return whether the target was ever found.

    Args:
        source: at its beginning.
        settings: all of them.
        selector: finds the target.
        telemetry: on the video's time; None if there is none.
        log: takes everything; the recorder's.
        clock: the log's and the frames'.
        progress: is shown each frame.
    """
    stage = VisionStage(make_target_tracker(settings))
    stage.select(selector)
    vision = VisionLoop(stage, clock, log)
    control: RecordedControl | None = None
    found = False
    for frame, following in with_next(frames_of(source)):
        clock.sleep_until(frame.captured_s)
        answer = vision.step(frame)
        vision.learn()
        found = found or answer.track is not None
        control = control or _control(settings, log, frame, telemetry)
        control.step(answer, None if following is None else following.captured_s)
        progress(frame)
    return found


def from_time(selector: Selector, at_s: float) -> Selector:
    """Return a selector that looks at nothing before `at_s`."""

    def select(frame: Frame) -> Box | None:
        return selector(frame) if frame.captured_s >= at_s - 1e-6 else None

    return select


def frames_of(source: FrameSource) -> Iterator[Frame]:
    """Return the frames, up to the end or to where their size changes."""
    size: tuple[int, int] | None = None
    while (frame := source.read()) is not None:
        size = size or (frame.width, frame.height)
        if size != (frame.width, frame.height):
            return
        yield frame


def with_next(frames: Iterator[Frame]) -> Iterator[tuple[Frame, Frame | None]]:
    """Return each frame with the one after it, the last with None."""
    ended: chain[Frame | None] = chain(frames, (None,))
    for frame, following in pairwise(ended):
        if frame is not None:
            yield frame, following


def _control(
    settings: Settings, log: FlightLog, first: Frame, telemetry: TelemetryLog | None
) -> RecordedControl:
    if telemetry is None:
        return RecordedControl(settings, log, first)
    playback = TelemetryPlayback(telemetry, first.captured_s)
    return RecordedControl(settings, log, first, playback.until, bool(telemetry.positions))
