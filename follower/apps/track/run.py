"""Follows targets through a source of frames, recorded or live."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from follower.apps.video_input import UntilResized, VideoInput
from follower.flight.control.offline import RecordedControl, recorded_settings
from follower.flight.log import FlightLog, FlightSink, SelectionRecord, Stopwatch, TrackRecord
from follower.flight.target.selectors import TargetsSelector
from follower.flight.vision.video_sink import FlightVideo
from follower.recording import LOCKSTEP_EPOCH_NS, FlightConfig, Recorder, epoch_now_ns
from follower.recording.recorder import LOG
from follower.recording.run_folder import (
    write_boxes,
    write_setpoints,
    write_target_boxes,
)
from follower.report.figures import write_targets_plot, write_track_plot
from follower.settings.settings import Settings
from follower_control.common.strict_config import SettingsError
from follower_vision.clock import Clock
from follower_vision.disk import can_be_written
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import FrameSource, SourceError
from follower_vision.sources.live_source import LiveSource
from follower_vision.trackers.target_tracker import MultiTargetTracker
from follower_vision.trackers.track import Track

MakeControl = Callable[[FlightLog, Frame], RecordedControl]


class TrackRun:
    """First finds the targets, then follows them to the source's end, or until it is stopped.

    `find` and `follow` are called one after the other, on any thread; `stop` and everything else
    on any other meanwhile.

    Args:
        source: at its beginning.
        tracker: not started yet.
        selector: finds the targets.
        count: how many there are.
        clock: the frames' own. A simulated one is moved along with them.

    Attributes:
        first: the frame in which the targets were found; set once `find` has found them.
    """

    first: Frame

    def __init__(
        self,
        source: FrameSource,
        tracker: MultiTargetTracker,
        selector: TargetsSelector,
        count: int,
        clock: Clock,
    ) -> None:
        self.source = source
        self._frames = UntilResized(source)
        self.logs = [FlightLog() for _ in range(count)]
        self._tracker = tracker
        self._selector = selector
        self.clock = clock
        self._stop = threading.Event()
        self._tracks: list[Track] = []
        self._box: Box | None = None

    def stop(self) -> None:
        """End `find` or `follow` after the frame that is being worked on."""
        self._stop.set()
        if isinstance(self.source, LiveSource):
            # Its reader may be waiting for a frame that never comes.
            self.source.close()

    @property
    def problem(self) -> str | None:
        """What ended the run early or is missing in it, in one line; None if nothing."""
        live = isinstance(self.source, LiveSource)
        return self._frames.resized if live else self._frames.problem

    def find(self) -> bool:
        """Read frames until all targets are seen in one, and start there; return whether they are.

        Raises:
            SourceError: there is no frame at all, or the selector or the tracker refuses one.
        """
        while (frame := self._next()) is not None:
            timer, received_s = Stopwatch(), self.clock.now()
            boxes = self._selector(frame)
            tracks = self._started(frame, boxes) if boxes else []
            self._record(frame, tracks, received_s, timer.elapsed_s())
            if tracks:
                self.first, self._tracks = frame, tracks
                return True
        if not self.logs[0].tracks and not self._stop.is_set():
            raise SourceError(f"no frame could be read: {self.problem or 'the source is empty'}")
        return False

    def follow(
        self,
        video: FlightVideo | None = None,
        control: MakeControl | None = None,
        recorder: FlightSink | None = None,
    ) -> None:
        """Follow the targets from the frame in which they were found.

        Args:
            video: is given each frame.
            control: makes what steers by the first target, if anything is to.
            recorder: is given all about the first target.
        """
        current, tracks = self.first, self._tracks
        if recorder is not None:
            self._begin_recording(recorder, current)
        frame: Frame | None = current
        steering = None if control is None else control(self.logs[0], current)
        while frame is not None:
            if video is not None:
                video.add(frame, tracks, ())
            frame = self._next()
            if steering is not None:
                newest = self.logs[0].tracks[-1]
                steering.step(newest, None if frame is None else frame.captured_s)
            if frame is not None:
                timer, received_s = Stopwatch(), self.clock.now()
                self.logs[0].pass_frame_on(frame, received_s)
                tracks = self._tracker.step(frame)
                self._record(frame, tracks, received_s, timer.elapsed_s())

    def _begin_recording(self, recorder: FlightSink, frame: Frame) -> None:
        log, record = self.logs[0], self.logs[0].tracks[-1]
        log.sink = recorder
        log.pass_frame_on(frame, record.received_s)
        if self._box is not None:
            chosen = SelectionRecord(frame.sequence, frame.captured_s, self._box)
            log.pass_on(chosen, record.received_s)
        recorder.add(record, record.done_s)

    def _started(self, frame: Frame, boxes: Sequence[Box]) -> list[Track]:
        try:
            self._box = boxes[0]
            return self._tracker.start(frame, boxes)
        except ValueError as error:
            raise SourceError(f"this target cannot be followed: {error}") from error

    def _next(self) -> Frame | None:
        """Return the next frame, None at the end; where the size changes is an end, too."""
        if self._stop.is_set():
            return None
        frame = self._frames.read()
        if frame is None:
            return None
        self.clock.sleep_until(frame.captured_s)
        return frame

    def _record(
        self, frame: Frame, tracks: Sequence[Track], received_s: float, busy_s: float
    ) -> None:
        """Log a frame for each target."""
        done_s = self.clock.now()
        for index, log in enumerate(self.logs):
            track = tracks[index] if tracks else None
            log.add_track(
                TrackRecord(track, frame.sequence, frame.captured_s, received_s, done_s, busy_s)
            )


@dataclass(frozen=True, slots=True)
class TrackFiles:
    """Where everything of one run goes.

    Attributes:
        out: takes the run's folder.
        save: the video with overlay (MP4); None puts it into the run's folder.
        boxes: the boxes (CSV); None puts them there, too.
        video: whether the video is written.
        record: whether a recording is.

    Raises:
        SettingsError: a file could not be written; says which option, and what to give instead.
    """

    out: Path = Path("runs")
    save: Path | None = None
    boxes: Path | None = None
    video: bool = True
    record: bool = False

    def __post_init__(self) -> None:
        if not self.video and self.save is not None:
            raise SettingsError("--save and --no-video contradict each other")
        if self.out.exists() and not self.out.is_dir():
            raise SettingsError(f"--out {self.out}: this is a file; give a folder")
        if self.save and self.save.suffix.lower() != ".mp4":
            raise SettingsError(
                f"--save {self.save}: an MP4 is written; give a name that ends in .mp4"
            )
        if self.save and self.boxes and self.save.resolve() == self.boxes.resolve():
            raise SettingsError(f"--save and --boxes are both {self.save}; give two names")

    def check(self, source: Path) -> None:
        """Refuse at once what could not be written at the end, or would overwrite the source.

        Raises:
            SettingsError: says which option, and what to give instead.
        """
        for option, path in (("--save", self.save), ("--boxes", self.boxes)):
            wrong = None if path is None else _unwritable(path, source)
            if wrong is not None:
                raise SettingsError(f"{option} {path}: {wrong}")

    def video_in(self, folder: Path) -> Path | None:
        """Return where the video goes, None if it is not wanted."""
        return (self.save or folder / "track.mp4") if self.video else None

    def write(self, folder: Path, logs: Sequence[FlightLog]) -> list[Path]:
        """Write all but the video; return all files there are, the video first.

        Args:
            folder: the run's own.
            logs: one for each target; setpoints are the first one's, if it has any.

        Raises:
            OSError: a file cannot be written.
        """
        boxes, plot = self.boxes or folder / "boxes.csv", folder / "track.png"
        if len(logs) == 1:
            write_boxes(boxes, logs[0].tracks)
            write_track_plot(plot, logs[0])
        else:
            write_target_boxes(boxes, [log.tracks for log in logs])
            write_targets_plot(plot, logs)
        files = [boxes, plot]
        if logs[0].controls:
            files.append(folder / "setpoints.csv")
            write_setpoints(files[-1], logs[0].controls)
        if self.record:
            files.append(folder / LOG)
        video = self.video_in(folder)
        return files if video is None else [video, *files]


def _unwritable(path: Path, source: Path) -> str | None:
    if path.is_dir():
        return "this is a folder; give a file's name"
    if not path.parent.is_dir():
        return f"there is no folder {path.parent}; make it first"
    if path.exists() and source.exists() and path.samefile(source):
        return "that is the source itself; give another name"
    if path.exists() and not path.is_file():
        return None  # opened and closed, a pipe has ended for its reader
    file = path.resolve()
    if not can_be_written(file.parent):
        return "cannot be written: its folder must not be changed"
    existed = file.exists()
    try:
        with file.open("ab"):
            pass
    except OSError as error:
        return f"cannot be written: {error.strerror}"
    if not existed:
        file.unlink()
    return None


def track_recorder(
    folder: Path, settings: Settings, source: VideoInput, count: int, clock: Clock
) -> Recorder:
    """Return the recorder of a run into its folder.

    Of several targets the first one is recorded: the one that setpoints are made for.

    Raises:
        OSError: the files cannot be made.
    """
    live = source.in_real_time
    # Detection in the background, and detection that targets share, has a time of its own.
    detection = "background" if live else "shared" if count > 1 else "inline"
    config = FlightConfig.of(
        "video",
        recorded_settings(settings),
        run={"source": source.shown, "targets": count, "detection": detection},
        needs_telemetry=False,
        epoch_ns=epoch_now_ns(clock) if live else LOCKSTEP_EPOCH_NS,
    )
    return Recorder(folder, config, clock, settings.recorder, threaded=live)
