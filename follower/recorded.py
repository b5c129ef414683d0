"""Recorded video through the stages that fly: tracks, and the setpoints that would be sent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from follower.control_stage import ControlStage
from follower.flight_video import FlightVideo
from follower.flightlog import FlightLog, TrackRecord
from follower.realtime import VisionLoop
from follower.settings import Settings
from follower.tracking import make_target_tracker
from follower.vision_stage import Selector, VisionStage
from follower_control.envelope import EnvelopeSettings
from follower_control.vehicle import VehicleState
from follower_vision.clock import SimulatedClock
from follower_vision.framesource import FrameSource, SourceError

OnFrame = Callable[[TrackRecord], None]


class RecordedRun:
    """Steps vision and control through a recording, on the recording's own time.

    There is no telemetry: the estimator works on the body's axes, and the envelope does without
    the limits that need a height or a position. The vehicle is taken to stand still and to allow
    following all the time.

    Args:
        settings: all of them; the camera's have to fit the recording.
        source: the recording, at its beginning.
        selector: finds the target in the first frames.

    Raises:
        SourceError: there is no frame, or the selector refuses the first one.
    """

    def __init__(self, settings: Settings, source: FrameSource, selector: Selector) -> None:
        self._source = source
        self._first = source.read()
        if self._first is None:
            raise SourceError(f"no frame could be read: {source.problem or 'the source is empty'}")
        selector(self._first)
        self._settings = settings.model_copy(update={"envelope": _without_position(settings)})
        self._stage = VisionStage(make_target_tracker(settings))
        self._stage.select(selector)
        self._clock = SimulatedClock(self._first.captured_s)
        self._due_s = self._first.captured_s
        self.log = FlightLog()

    def run(self, video: FlightVideo | None, on_frame: OnFrame) -> None:
        """Go through the recording to its end; `on_frame` is shown each frame's record."""
        frame = self._first
        if frame is None:
            return
        vision = VisionLoop(self._stage, self._clock, self.log, video)
        camera = self._settings.camera.model(frame.width, frame.height)
        control = ControlStage(self._settings, camera, self.log, needs_telemetry=False)
        while frame is not None:
            self._clock.sleep_until(frame.captured_s)
            record = vision.step(frame)
            on_frame(record)
            frame = self._source.read()
            self._control(control, record, None if frame is None else frame.captured_s)

    def _control(
        self, control: ControlStage, newest: TrackRecord, next_frame_s: float | None
    ) -> None:
        """Step control at its own rate up to the next frame, once more after the last one."""
        period_s = 1.0 / self._settings.control_rate_hz
        end_s = self._due_s + period_s / 2 if next_frame_s is None else next_frame_s
        while self._due_s < end_s:
            here = VehicleState(
                mode="recorded", obeys_setpoints=True, armed=True, heartbeat_s=self._due_s
            )
            control.step(self._due_s, newest, here)
            self._due_s += period_s


def _without_position(settings: Settings) -> EnvelopeSettings:
    return replace(settings.envelope, min_height_m=None, ceiling_m=None, fence_radius_m=None)
