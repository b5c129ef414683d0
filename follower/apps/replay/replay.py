"""A recorded flight through vision and control again, step by step as it went."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from follower.control_stage import ControlStage
from follower.excite.pattern import recorded_pattern
from follower.excite.stage import ExcitationStage
from follower.flightlog import ControlRecord, FlightLog, FlightSink, Selection, TrackRecord
from follower.recorder import FlightFileError, RecordedFlight
from follower.recorder.records import FrameRecord, StepRecord
from follower.recorder.video_reading import PictureFinder
from follower.settings import Settings, load_settings
from follower.stopwatch import Stopwatch
from follower.tracking import make_target_tracker
from follower.vision_stage import Selector, VisionStage
from follower_vision.box import Box
from follower_vision.camera import CameraModel
from follower_vision.frame import Frame
from follower_vision.target_tracker import TargetTracker

OnMessage = Callable[[float, object], None]


def replay_settings(flight: RecordedFlight, overrides: Sequence[str] = ()) -> Settings:
    """Return the flight's own settings with other values for some of them.

    Raises:
        SettingsError: an override cannot be used, or a recorded setting no longer exists.
    """
    return load_settings(None, flight.config.settings, overrides)


class Replay:
    """Runs a flight's frames and telemetry through the stages in the order that was recorded.

    Which track a control step had, which attitudes had come, what the operator had asked for: all
    that comes from the recording, so that a flight of many threads is replayed as it went. Nothing
    that the replay decides changes what it is given: the loop is open.

    Frames that are not in the video are not seen by the replay; control then gets the recorded
    track.

    Args:
        flight: the recording.
        settings: its own ones, or others.
        own_camera: use the recorded intrinsics instead of those that the settings describe.
        tracker: None makes the one that the settings name.
        tracks_recorded: leave vision out and give control the recorded tracks.
        on_message: is shown each recorded message, after what it stands for was done.
        sink: is told what comes of it, as a recorder is.

    Attributes:
        log: what came of it.
        missed: how many frames vision did not get.
    """

    def __init__(
        self,
        flight: RecordedFlight,
        settings: Settings,
        *,
        own_camera: bool = True,
        tracker: TargetTracker | None = None,
        tracks_recorded: bool = False,
        on_message: OnMessage | None = None,
        sink: FlightSink | None = None,
    ) -> None:
        self.log = FlightLog(sink=sink)
        self.missed = 0
        self._flight = flight
        self._tracks_recorded = tracks_recorded
        self._on_message = on_message
        self._tracks: dict[int, TrackRecord] = {}
        self._frame: Frame | None = None
        self._pictures = PictureFinder(iter(()) if tracks_recorded else flight.pictures())
        if not tracks_recorded:
            self._stage = VisionStage(tracker or make_target_tracker(settings))
        camera = _camera(flight, settings, own_camera)
        needs_telemetry = flight.config.needs_telemetry
        pattern = recorded_pattern(flight.config.run)
        if pattern is None:
            self._control = ControlStage(settings, camera, self.log, needs_telemetry)
        else:
            self._control = ExcitationStage(settings, pattern, camera, self.log)
        self._steps = iter(flight.log.controls)

    @property
    def stage(self) -> ControlStage:
        """Control, whose errors are worth showing."""
        return self._control

    def run(self) -> FlightLog:
        """Go through the recording to its end and return the log.

        Raises:
            FlightFileError: the recording contradicts itself.
        """
        for time_s, message in self._flight.messages():
            self._take(message)
            if self._on_message is not None:
                self._on_message(time_s, message)
        return self.log

    def _take(self, message: object) -> None:
        if isinstance(message, FrameRecord):
            self._frame = self._pictures.of(message)
        elif isinstance(message, Selection) and not self._tracks_recorded:
            self._choose(message.box)
        elif isinstance(message, TrackRecord):
            self._tracks[message.sequence] = self._track(message)
        elif isinstance(message, StepRecord):
            self._step(next(self._steps))

    def _choose(self, box: Box | None) -> None:
        if box is None:
            self._stage.drop()
        else:
            self._stage.select(_recorded_choice(box))

    def _track(self, recorded: TrackRecord) -> TrackRecord:
        """Return vision's answer today; times are those of the recording."""
        if self._tracks_recorded:
            self.log.add_track(recorded)
            return recorded
        if self._frame is None or self._frame.sequence != recorded.sequence:
            self.missed += 1
            return recorded
        timer = Stopwatch()
        self._stage.prospects = lambda *_: recorded.prospect
        track = self._stage.step(self._frame)
        answer = replace(recorded, track=track, busy_s=timer.elapsed_s())
        self._stage.learn()
        self.log.add_track(answer)
        return answer

    def _step(self, recorded: ControlRecord) -> None:
        sequence = recorded.track_sequence
        newest = None if sequence is None else self._tracks.get(sequence)
        if sequence is not None and newest is None:
            raise FlightFileError(
                f"{self._flight.folder}: the control step at {recorded.time_s:.3f} s used the "
                f"track of frame {sequence}, which is not in the log"
            )
        if recorded.situation is not None:
            self._control.repeat_requests(recorded.situation)
        if recorded.mode_asked is not None:
            self._control.change_mode(recorded.mode_asked)
        self._control.repeat_changes(recorded.changes)
        self._control.step(
            recorded.time_s,
            newest,
            recorded.vehicle,
            recorded.attitudes,
            recorded.late_s,
            recorded.health,
        )


def _recorded_choice(box: Box) -> Selector:
    return lambda _: box


def _camera(flight: RecordedFlight, settings: Settings, own: bool) -> CameraModel:
    if own and flight.config.camera is not None:
        return flight.config.camera
    if not flight.frames:
        raise FlightFileError(f"{flight.folder}: no frame was recorded, nothing can be replayed")
    return settings.camera.model(flight.frames[0].width, flight.frames[0].height)
