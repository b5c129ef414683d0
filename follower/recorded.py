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
from follower.vision_stage import VisionStage
from follower_control.envelope import EnvelopeSettings
from follower_control.vehicle import VehicleState
from follower_vision.box import Box
from follower_vision.clock import SimulatedClock
from follower_vision.frame import Frame
from follower_vision.framesource import FrameSource, SourceError

OnFrame = Callable[[TrackRecord], None]


class RecordedRun:
    """Steps vision and control through a recording, on the recording's own time.

    There is no telemetry: the estimator works on the body's axes, and the envelope does without
    the limits that need a height or a position. The vehicle is taken to stand still and to allow
    following all the time.
    """

    def __init__(
        self, settings: Settings, source: FrameSource, video: FlightVideo | None = None
    ) -> None:
        self._settings = settings.model_copy(update={"envelope": _without_position(settings)})
        self._source = source
        self._clock = SimulatedClock()
        self._video = video
        self._due_s = 0.0
        self.log = FlightLog()

    def run(self, target: Box, on_frame: OnFrame) -> None:
        """Track `target`, a box in the first frame, to the recording's end.

        `on_frame` is shown each frame's record; an exception from it, such as the user's
        interrupt, ends the run with the log complete so far.

        Raises:
            SourceError: there is no frame, or the target does not lie in the first one.
        """
        frame = self._source.read()
        if frame is None:
            raise SourceError(f"no frame could be read: {self._source.problem or 'it is empty'}")
        check_target(target, frame)
        stage = VisionStage(make_target_tracker(self._settings))
        stage.select(lambda _frame: target)
        vision = VisionLoop(stage, self._clock, self.log, self._video)
        camera = self._settings.camera.model(frame.width, frame.height)
        control = ControlStage(self._settings, camera, self.log, needs_telemetry=False)
        self._due_s = frame.captured_s
        while frame is not None:
            self._clock.sleep_until(frame.captured_s)
            record = vision.step(frame)
            on_frame(record)
            frame = self._source.read()
            self._control_until(control, record, None if frame is None else frame.captured_s)

    def _control_until(
        self, control: ControlStage, newest: TrackRecord, next_frame_s: float | None
    ) -> None:
        """Step control at its own rate up to the next frame; at least once a frame's answer."""
        period_s = 1.0 / self._settings.control_rate_hz
        end_s = self._due_s + period_s / 2 if next_frame_s is None else next_frame_s
        while self._due_s < end_s:
            here = VehicleState(
                mode="recorded", obeys_setpoints=True, armed=True, heartbeat_s=self._due_s
            )
            control.step(self._due_s, newest, here)
            self._due_s += period_s


def check_target(target: Box, frame: Frame) -> None:
    """Refuse a target that lies outside the image.

    Raises:
        SourceError: less than a tenth of the box is in the image.
    """
    if target.visible_share(frame.width, frame.height) < 0.1:
        x, y, width, height = target.xywh
        raise SourceError(
            f"the target {x:g},{y:g},{width:g},{height:g} lies outside the image, which is "
            f"{frame.width}x{frame.height}: give x,y,w,h of a box in the first frame"
        )


def _without_position(settings: Settings) -> EnvelopeSettings:
    return replace(settings.envelope, min_height_m=None, ceiling_m=None, fence_radius_m=None)
