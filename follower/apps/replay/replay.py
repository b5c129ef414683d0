"""A recorded flight through vision and control again, step by step as it went."""

import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from follower.flight.control.stage import ControlStage
from follower.flight.log import (
    ControlRecord,
    DetectionRecord,
    Event,
    FlightLog,
    FlightSink,
    LogRecord,
    SelectionRecord,
    Stopwatch,
    TrackRecord,
)
from follower.flight.vision.stage import VisionStage
from follower.flight.vision.tracker_factory import make_target_tracker, make_tracker_with
from follower.recording import FlightConfig, FlightFileError, RecordedFlight
from follower.recording.config import RECORDED
from follower.recording.mcap_writer import McapLog
from follower.recording.messages import FrameRecord, StepRecord, messages_of
from follower.recording.recorder import CONFIG, LOG, TLOG
from follower.recording.video_reader import FrameFinder
from follower.recording.video_writer import VIDEO
from follower.settings.settings import Settings, as_recorded, load_settings
from follower.tuning.excite.pattern import recorded_pattern
from follower.tuning.excite.stage import ExcitationStage
from follower_sim.kinematics import TruthSample
from follower_vision.detection import Detection
from follower_vision.detection.detection_service import DetectionAnswer, DetectionRequest
from follower_vision.geometry.box import Box
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.images.frame import Frame, Image
from follower_vision.sources.frame_source import ClosesItself
from follower_vision.trackers.target_tracker import TargetTracker

_NO_IMAGE = np.empty((0, 0, 3), np.uint8)
OnMessage = Callable[[float, object], None]


def replay_settings(flight: RecordedFlight, overrides: Sequence[str] = ()) -> Settings:
    """Return the flight's own settings with other values for some of them.

    Raises:
        SettingsError: an override cannot be used, or a recorded setting is unknown.
    """
    return load_settings(None, as_recorded(flight.config.settings), overrides)


class RecordedDetections:
    """Another time's detector: gives each frame the answers that were recorded for it.

    It is a `DetectionService`, and stands for the `Detector` behind it, too.
    """

    class_names: tuple[str, ...] = ()

    def __init__(self) -> None:
        self._answers: list[DetectionRecord] = []

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:  # noqa: ARG002
        """See nothing: nobody asks."""
        return []

    def put(self, record: DetectionRecord) -> None:
        """Give the next frame an answer."""
        self._answers.append(record)

    def ready(self, *, urgent: bool = False) -> bool:  # noqa: ARG002
        """Tell that nothing need be asked."""
        return False

    def submit(self, request: DetectionRequest) -> None:
        """Do nothing."""

    def take(self, owner: object) -> list[DetectionAnswer]:
        """Return what was put since."""
        taken, self._answers = self._answers, []
        return [
            DetectionAnswer(
                DetectionRequest(owner, one.index, _NO_IMAGE, None), list(one.detections)
            )
            for one in taken
        ]

    def forget(self, owner: object) -> None:
        """Do nothing: what was forgotten was not recorded."""

    def close(self) -> None:
        """Do nothing."""


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
        tracks_recorded: leave vision out and give control the recorded tracks.
        on_message: is shown each recorded message, after what it stands for was done.
        sink: is given what comes of it, as a recorder is.

    Attributes:
        log: what came of it.
        missed: how many frames vision did not get.
        stage: control, whose errors are worth showing.
    """

    def __init__(
        self,
        flight: RecordedFlight,
        settings: Settings,
        *,
        own_camera: bool = True,
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
        self._pictures = FrameFinder(iter(()) if tracks_recorded else flight.pictures())
        self._detections = RecordedDetections()
        if not tracks_recorded:
            self._vision = VisionStage(self._make_tracker(settings))
        camera = _camera(flight, settings, own_camera)
        needs_telemetry = flight.config.needs_telemetry
        pattern = recorded_pattern(flight.config.run)
        if pattern is None:
            self.stage = ControlStage(settings, camera, self.log, needs_telemetry)
        else:
            self.stage = ExcitationStage(settings, pattern, camera, self.log)
        self._steps = iter(flight.log.controls)

    def _make_tracker(self, settings: Settings) -> TargetTracker:
        """Return the settings' tracker; the recorded detector is not asked anew, another one is."""
        run, own = self._flight.config.run, self._flight.config.settings.get("detector")
        if run.get("detection") != RECORDED or settings.detector != own:
            return make_target_tracker(settings)
        detector = self._detections if run.get("detector") or own else None
        return make_tracker_with(detector, settings, lambda _: self._detections)

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
        elif isinstance(message, SelectionRecord) and not self._tracks_recorded:
            self._choose(message.box)
        elif isinstance(message, DetectionRecord):
            self._detections.put(message)
        elif isinstance(message, TrackRecord):
            self._tracks[message.sequence] = self._track(message)
        elif isinstance(message, StepRecord):
            self._step(next(self._steps))

    def _choose(self, box: Box | None) -> None:
        if box is None:
            self._vision.drop()
        else:
            self._vision.select(lambda _: box)

    def _track(self, recorded: TrackRecord) -> TrackRecord:
        """Return vision's answer today; times are those of the recording."""
        if self._tracks_recorded:
            self.log.add_track(recorded)
            return recorded
        if self._frame is None or self._frame.sequence != recorded.sequence:
            self.missed += 1
            self.log.pass_on(recorded, recorded.done_s)  # control uses it, in a saved replay too
            return recorded
        timer = Stopwatch()
        self._vision.prospects = lambda *_: recorded.prospect
        track = self._vision.step(self._frame)
        answer = replace(recorded, track=track, busy_s=timer.elapsed_s())
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
            self.stage.repeat_requests(recorded.situation)
        self.stage.repeat_changes(recorded.changes)
        self.stage.step(
            recorded.time_s,
            newest,
            recorded.vehicle,
            recorded.attitudes,
            recorded.late_s,
            recorded.health,
        )


def _camera(flight: RecordedFlight, settings: Settings, own: bool) -> CameraModel:
    if own and flight.config.camera is not None:
        return flight.config.camera
    if not flight.frames:
        raise FlightFileError(f"{flight.folder}: no frame was recorded, nothing can be replayed")
    return settings.camera.model(flight.frames[0].width, flight.frames[0].height)


_COMMIT_EVERY = 2000
_KEPT = (FrameRecord, SelectionRecord, DetectionRecord, TruthSample)


class ReplaySaver(ClosesItself):
    """Takes the replay's log as it grows and writes a flight folder, whose video is the old one.

    Args:
        flight: what is replayed.
        folder: exists and is empty.
        settings: of the replay.
        overrides: what is other in them than in the flight's, as on the command line. Such a replay
            is labelled open loop.

    Raises:
        OSError: it cannot be written.
    """

    def __init__(
        self,
        flight: RecordedFlight,
        folder: Path,
        settings: Settings,
        overrides: Sequence[str] = (),
    ) -> None:
        earlier = flight.config.run.get("open_loop")
        label = {"open_loop": f"replayed with {', '.join(overrides)}"} if overrides else {}
        if earlier and overrides:
            label["open_loop"] = f"{earlier}, {label['open_loop']}"
        run = {**flight.config.run, **label, "tracks_from": "the recorded video, decoded"}
        now = FlightConfig.of(flight.config.kind, settings)
        config = replace(
            flight.config,
            settings=now.settings,
            versions=now.versions,
            processor=now.processor,
            models=now.models,
            run=run,
        )
        (folder / CONFIG).write_text(config.to_yaml(), "utf-8")
        self._log = McapLog(folder / LOG, config.epoch_ns, config.to_yaml())
        self._waiting = 0
        for name in (TLOG, VIDEO):
            _link(flight.folder / name, folder / name)

    def __call__(self, time_s: float, message: object) -> None:
        """Copy a recorded message that the replay does not make anew."""
        own_event = isinstance(message, Event) and message.source != "supervisor"
        if isinstance(message, _KEPT) or own_event:
            self._write(message, time_s)

    def close(self) -> None:
        """Finish the log."""
        self._log.close()

    def add_frame(self, frame: Frame, received_s: float) -> None:
        """Do nothing: the recorded frame was copied."""

    def add(self, record: LogRecord, time_s: float) -> None:
        """Write what the replay made; the recorded selection was copied."""
        if not isinstance(record, SelectionRecord):
            for message in messages_of(record):
                self._write(message, time_s)

    def _write(self, message: object, time_s: float) -> None:
        self._log.write(message, time_s)
        self._waiting += 1
        if self._waiting >= _COMMIT_EVERY:
            self._waiting = 0
            self._log.commit()


def _link(source: Path, target: Path) -> None:
    """Give a file a second name, or copy it where the disks differ; nothing if there is none."""
    try:
        os.link(source, target)
    except FileNotFoundError:
        return
    except OSError:
        shutil.copyfile(source, target)
