"""`follower track`: targets followed through video, recorded or live."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing, nullcontext
from functools import partial
from pathlib import Path
from typing import TypeVar

from rich.console import Console

from follower.candidates import summary, write_candidates
from follower.flight_video import BackgroundVideo
from follower.flightlog import FlightLog
from follower.interrupt import StopOnInterrupt
from follower.object_listing import list_objects
from follower.object_selector import ChoiceError, ObjectSelector, Wanted
from follower.recorded import RecordedControl
from follower.selecting import TargetsSelector, all_selected, box_selector, colour_selector
from follower.settings import Settings
from follower.track_display import TrackDisplay
from follower.track_files import TrackFiles, check_destinations, run_folder
from follower.track_options import LIST, TrackOptions
from follower.track_recording import track_recorder
from follower.track_run import TrackRun
from follower.track_status import TrackStatus, counted
from follower.tracking import make_multi_tracker, make_settings_detector
from follower.watched import run_watched, stop_signals
from follower_vision.clock import Clock, MonotonicClock, SimulatedClock
from follower_vision.detection import Detector
from follower_vision.framesource import FrameSource, SourceError
from follower_vision.fusion import BackgroundDetection, InlineDetection
from follower_vision.live import LiveSource
from follower_vision.network import ModelError
from follower_vision.paced import Paced
from follower_vision.sources import is_live, open_source
from follower_vision.track import TrackState

ResultT = TypeVar("ResultT")

_SUCCESS, _BROKEN_OFF, _INTERRUPTED = 0, 1, 130


def track(options: TrackOptions) -> int:
    """Run the command and return its exit code.

    Raises:
        ValueError, OSError: what the user can mend, in one line; nothing is left behind then but
            the picture that the message names, if it names one.
    """
    check_destinations(options)
    settings = options.settings()
    detector = make_settings_detector(settings)
    clock: Clock = MonotonicClock() if options.in_real_time else SimulatedClock()
    console = Console()
    if LIST in options.select:
        with _opened(options, clock) as source:
            folder = partial(run_folder, options)
            return list_objects(source, _needed(detector), folder, console)
    selector = _selector(options, detector)
    mode = BackgroundDetection if options.in_real_time else InlineDetection
    with (
        stop_signals(),
        closing(make_multi_tracker(settings, options.count, detector, mode)) as tracker,
        _opened(options, clock) as source,
    ):
        run = TrackRun(source, tracker, selector, options.count, clock)
        return TrackSession(options, settings, run, selector, console).run()


class TrackSession:
    """One run in front of a user: the search, the pursuit, and the files afterwards."""

    def __init__(
        self,
        options: TrackOptions,
        settings: Settings,
        run: TrackRun,
        selector: TargetsSelector,
        console: Console,
    ) -> None:
        self._options = options
        self._settings = settings
        self._run = run
        self._selector = selector
        self._console = console
        self._display = TrackDisplay(console, _wish(options))

    def run(self) -> int:
        """Find the targets and follow them; return the exit code.

        Raises:
            SourceError: they were not found; nothing is written.
        """
        found, interrupted = self._find()
        if interrupted:
            self._display.say(f"Ended while waiting for {_wish(self._options)}: nothing is written")
            return _INTERRUPTED
        if not found:
            raise SourceError(self._nothing_found())
        if not self._options.in_real_time:  # what steers needs the lens; nothing is written before
            first = self._run.first
            self._settings.camera.model_of(self._options.source, first.width, first.height)
        files = TrackFiles.make(self._options)
        self._tell_choice(files.folder)
        interrupted = self._follow(files)
        with StopOnInterrupt():
            written = files.write(self._run.logs)
        if self._run.problem is not None:
            self._display.say(self._run.problem)
        self._summarise(written)
        if interrupted:
            return _INTERRUPTED
        broken = self._run.problem is not None and not self._options.in_real_time
        return _BROKEN_OFF if broken else _SUCCESS

    def _find(self) -> tuple[bool, bool]:
        try:
            return self._watched(self._run.find)
        except ChoiceError as error:
            picture = run_folder(self._options) / "candidates.png"
            write_candidates(picture, error.image, error.candidates)
            raise SourceError(f"{error}; {picture} shows what may be chosen") from None

    def _follow(self, files: TrackFiles) -> bool:
        """Follow to the end; return whether the user ended it."""
        live = self._options.in_real_time
        rate_hz = self._run.source.nominal_rate_hz
        control = None if live else partial(RecordedControl, self._settings)
        video = None if files.video is None else BackgroundVideo(files.video, rate_hz, not live)
        recording = track_recorder(self._options, self._settings, files.folder, self._run.clock)
        with video or nullcontext(), recording as recorder:
            follow = partial(self._run.follow, video, control, recorder)
            _, interrupted = self._watched(follow)
        remarks = list(() if recorder is None else recorder.remarks)
        if video is not None and video.remark is not None:
            remarks.insert(0, video.remark)
        gaps = [event for event in self._run.logs[0].events if event.source == "video"]
        if gaps:
            also = f", and {counted(len(gaps) - 1, 'more gap')}" if len(gaps) > 1 else ""
            remarks.append(f"At {gaps[0].time_s:.1f} s {gaps[0].text}{also}")
        for remark in remarks:
            self._display.say(remark)
        return interrupted

    def _watched(self, work: Callable[[], ResultT]) -> tuple[ResultT, bool]:
        with self._display as display:
            return run_watched(
                work, lambda: display.show(TrackStatus.of(self._run)), self._run.stop
            )

    def _nothing_found(self) -> str:
        advice = ""
        if isinstance(self._selector, ObjectSelector):
            advice = "; --select list shows what the detector sees"
        frames = counted(len(self._run.logs[0].tracks), "frame")
        return f"{_wish(self._options)} was not seen in {frames}{advice}"

    def _tell_choice(self, folder: Path) -> None:
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
        if isinstance(source, LiveSource | Paced):
            parts.append(f"{source.skipped} dropped")
        if isinstance(source, LiveSource):
            parts.append(counted(max(0, source.connections - 1), "reconnect"))
        parts.append(f"{1e3 * busy_s / max(frames, 1):.1f} ms a frame")
        self._display.say(", ".join(parts))
        for file in files:
            self._display.say(f"  {file}")


def _opened(options: TrackOptions, clock: Clock) -> FrameSource:
    source = open_source(options.source, folder_rate_hz=options.rate_hz, clock=clock)
    if options.realtime and not is_live(options.source):
        return Paced(source, clock)
    return source


def _selector(options: TrackOptions, detector: Detector | None) -> TargetsSelector:
    if options.select:
        knows = _needed(detector)
        wanted = [Wanted.parse(text, knows.class_names) for text in options.select]
        return ObjectSelector(wanted, knows)
    if options.colour is not None:
        return all_selected([colour_selector(options.colour)])
    return all_selected([box_selector(target) for target in options.targets])


def _needed(detector: Detector | None) -> Detector:
    if detector is None:
        raise ModelError("--select needs a detector; name one by --detector")
    return detector


def _wish(options: TrackOptions) -> str:
    if options.select:
        return ", ".join(options.select)
    return "the target" if options.colour is None else f"something of colour {options.colour}"


def _seen(logs: Sequence[FlightLog]) -> str:
    """Return how many frames each target was seen in: "310 (98.7 %)"."""
    shares = []
    for log in logs:
        states = [record.track.state for record in log.tracks if record.track is not None]
        seen = sum(state is TrackState.TRACKING for state in states)
        shares.append(f"{seen} ({100 * seen / max(1, len(log.tracks)):.1f} %)")
    return " / ".join(shares)
