"""`follower track`: targets followed through video, recorded or live."""

from collections.abc import Callable, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from rich.console import Console
from rich.table import Table

from follower.apps.target_choice import LIST, TargetChoice, needed
from follower.apps.track.display import TrackDisplay, TrackStatus
from follower.apps.track.run import TrackFiles, TrackRun, track_recorder
from follower.apps.video_input import VideoInput, gaps_said
from follower.flight.control.offline import RecordedControl
from follower.flight.log import FlightLog
from follower.flight.target.candidate_image import (
    NumberedObject,
    numbered,
    summary,
    write_candidates,
)
from follower.flight.target.selectors import (
    ChoiceError,
    ObjectSelector,
    TargetsSelector,
)
from follower.flight.vision.tracker_factory import make_multi_tracker, make_settings_detector
from follower.flight.vision.video_sink import BackgroundVideo
from follower.recording.run_folder import new_run_folder
from follower.settings.settings import Settings
from follower.ui.terminal.console import counted, print_line
from follower.ui.terminal.interrupt import StopOnInterrupt, run_watched, stop_signals
from follower_control.common.strict_config import SettingsError
from follower_vision.clock import Clock, MonotonicClock, SimulatedClock
from follower_vision.detection import Detector
from follower_vision.detection.detectors import scan
from follower_vision.fusion import BackgroundDetection, InlineDetection
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import FrameSource, RealtimePlayback, SourceError
from follower_vision.sources.live_source import LiveSource
from follower_vision.sources.open import local_path
from follower_vision.trackers.track import TrackState

ResultT = TypeVar("ResultT")

_SUCCESS, _BROKEN_OFF, _INTERRUPTED = 0, 1, 130


def list_objects(
    source: FrameSource, detector: Detector, folder: Callable[[], Path], console: Console
) -> int:
    """Print and draw what is seen in the first frame in which anything is; return the exit code.

    Args:
        source: at its beginning.
        detector: any.
        folder: makes the folder for the picture.
        console: where to.

    Raises:
        SourceError: nothing is seen in any frame.
        OSError: the picture cannot be written.
    """
    frame, candidates = _first_seen(source, detector)
    picture = write_candidates(folder() / "candidates.png", frame.image, candidates)
    print_line(console, f"frame {frame.sequence}, {frame.width}x{frame.height} pixels")
    console.print(_table(candidates))
    choice = f"--select {candidates[0].name} or --select {candidates[0].number}"
    print_line(console, f"follow one by {choice}, or by --target with its box")
    print_line(console, f"  {picture}")
    return 0


def _first_seen(source: FrameSource, detector: Detector) -> tuple[Frame, list[NumberedObject]]:
    count = 0
    while (frame := source.read()) is not None:
        candidates = numbered(scan(detector, frame.image), frame)
        if candidates:
            return frame, candidates
        count += 1
    reason = source.problem or "try another detector, or give --target x,y,w,h"
    raise SourceError(f"the detector sees nothing that it knows in {count} frames; {reason}")


def _table(candidates: Sequence[NumberedObject]) -> Table:
    table = Table("number", "name", "score", "x,y,w,h", show_edge=False, pad_edge=False)
    for one in candidates:
        box = ",".join(f"{value:.0f}" for value in one.box.xywh)
        table.add_row(str(one.number), one.name, f"{one.score:.2f}", box)
    return table


def track(settings: Settings, targets: TargetChoice, source: VideoInput, files: TrackFiles) -> int:
    """Run the command and return its exit code.

    Args:
        settings: of vision, control and the recorder.
        targets: to follow.
        source: of the frames.
        files: to write.

    Raises:
        ValueError, OSError: what the user can mend, in one line; nothing is left behind then but
            the picture that the message names, if it names one.
    """
    if not targets.given:
        raise SettingsError(
            "which target? give --target x,y,w,h or --select person or --colour '#rrggbb'; "
            "--select list shows what there is"
        )
    files.check(local_path(source.name))
    detector = make_settings_detector(settings)
    clock: Clock = MonotonicClock() if source.in_real_time else SimulatedClock()
    console = Console()
    new_folder = partial(new_run_folder, files.out, f"track-{source.short_name}")
    if LIST in targets.select:
        with source.open(clock) as frames:
            return list_objects(frames, needed(detector), new_folder, console)
    selector = targets.selector(detector)
    mode = BackgroundDetection if source.in_real_time else InlineDetection
    with (
        stop_signals(),
        closing(make_multi_tracker(settings, targets.count, detector, mode)) as tracker,
        source.open(clock) as frames,
    ):
        run = TrackRun(frames, tracker, selector, targets.count, clock)
        display = TrackDisplay(console, str(targets))
        session = TrackSession(settings, run, selector, source, files, str(targets), display)
        return session.run(new_folder)


@dataclass(frozen=True, slots=True)
class TrackSession:
    """One run in front of a user: the search, the pursuit, and the files afterwards.

    Attributes:
        _settings: of vision, control and the recorder.
        _run: goes through the frames.
        _selector: the run's.
        _source: of the frames.
        _files: to write.
        _targets: in words.
        _display: shows the run.
    """

    _settings: Settings
    _run: TrackRun
    _selector: TargetsSelector
    _source: VideoInput
    _files: TrackFiles
    _targets: str
    _display: TrackDisplay

    def run(self, new_folder: Callable[[], Path]) -> int:
        """Find the targets and follow them; return the exit code.

        Args:
            new_folder: makes the run's folder, once there is something to write.

        Raises:
            SourceError: they were not found; nothing is written.
        """
        found, interrupted = self._find(new_folder)
        if interrupted:
            self._display.say(f"Ended while waiting for {self._targets}: nothing is written")
            return _INTERRUPTED
        if not found:
            listed = isinstance(self._selector, ObjectSelector)
            advice = "; --select list shows what the detector sees" if listed else ""
            frames = counted(len(self._run.logs[0].tracks), "frame")
            raise SourceError(f"{self._targets} was not seen in {frames}{advice}")
        live = self._source.in_real_time
        if not live:  # control needs the lens; nothing is written before
            first = self._run.first
            self._settings.camera.model_of(self._source.name, first.width, first.height)
        folder = new_folder()
        self._report_choice(folder)
        interrupted = self._follow(folder)
        with StopOnInterrupt():
            written = self._files.write(folder, self._run.logs)
        if self._run.problem is not None:
            self._display.say(self._run.problem)
        self._summarise(written)
        if interrupted:
            return _INTERRUPTED
        broken = self._run.problem is not None and not self._source.is_live
        return _BROKEN_OFF if broken else _SUCCESS

    def _find(self, new_folder: Callable[[], Path]) -> tuple[bool, bool]:
        try:
            return self._watched(self._run.find)
        except ChoiceError as error:
            picture = new_folder() / "candidates.png"
            write_candidates(picture, error.image, error.candidates)
            raise SourceError(f"{error}; {picture} shows what may be chosen") from None

    def _follow(self, folder: Path) -> bool:
        """Follow to the end; return whether the user ended it."""
        live, path = self._source.in_real_time, self._files.video_in(folder)
        rate_hz = self._run.source.nominal_rate_hz
        control = None if live else partial(RecordedControl, self._settings)
        keep_free_mb = self._settings.recorder.keep_free_mb
        video = None if path is None else BackgroundVideo(path, rate_hz, not live, keep_free_mb)
        recorder = None
        if self._files.record:
            count, clock = len(self._run.logs), self._run.clock
            recorder = track_recorder(folder, self._settings, self._source, count, clock)
        with video or nullcontext(), recorder or nullcontext():
            follow = partial(self._run.follow, video, control, recorder)
            _, interrupted = self._watched(follow)
        remarks = list(() if recorder is None else recorder.remarks)
        if video is not None and video.remark is not None:
            remarks.insert(0, video.remark)
        for remark in (*remarks, *gaps_said(self._run.logs[0])):
            self._display.say(remark)
        return interrupted

    def _watched(self, work: Callable[[], ResultT]) -> tuple[ResultT, bool]:
        with self._display as display:
            return run_watched(
                work, lambda: display.show(TrackStatus.of(self._run)), self._run.stop
            )

    def _report_choice(self, folder: Path) -> None:
        """Say which objects were chosen; where there were others, show them."""
        if not isinstance(self._selector, ObjectSelector):
            return
        candidates, first = self._selector.candidates, self._run.first
        names = ", ".join(one.name for one in self._selector.chosen)
        self._display.say(f"following {names} of {summary(candidates)} in frame {first.sequence}")
        if len(candidates) > len(self._selector.chosen):
            write_candidates(folder / "candidates.png", first.image, candidates)

    def _summarise(self, files: Sequence[Path]) -> None:
        logs, source = self._run.logs, self._run.source
        frames = len(logs[0].tracks)
        busy_s = sum(record.busy_s for record in logs[0].tracks)
        parts = [counted(frames, "frame"), f"target seen in {_seen(logs)}"]
        if isinstance(source, LiveSource | RealtimePlayback):
            parts.append(f"{source.skipped} dropped")
        if isinstance(source, LiveSource):
            parts.append(counted(max(0, source.connections - 1), "reconnect"))
        parts.append(f"{1e3 * busy_s / max(frames, 1):.1f} ms a frame")
        self._display.say(", ".join(parts))
        for file in files:
            self._display.say(f"  {file}")


def _seen(logs: Sequence[FlightLog]) -> str:
    """Return how many frames each target was seen in: "310 (98.7 %)"."""
    shares = []
    for log in logs:
        states = [record.track.state for record in log.tracks if record.track is not None]
        seen = sum(state is TrackState.TRACKING for state in states)
        shares.append(f"{seen} ({100 * seen / max(1, len(log.tracks)):.1f} %)")
    return " / ".join(shares)
