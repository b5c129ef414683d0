"""`follower import`: from a video, and perhaps a log, to a flight's folder, setpoints, a report."""

import math
import shutil
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
from rich.console import Console
from rich.status import Status

from follower.apps.command_settings import command_line
from follower.apps.import_flight.alignment import (
    align,
    corner_flows,
    offset_facts,
    offset_section,
    write_offset_plot,
)
from follower.apps.inspect import inspect_recorded
from follower.apps.target_choice import LIST, TargetChoice
from follower.apps.video_input import VideoInput
from follower.flight.control.offline import RecordedControl, recorded_settings
from follower.flight.log import FlightLog
from follower.flight.target.selectors import Selector, TargetsSelector
from follower.flight.threads import VisionLoop
from follower.flight.vision.stage import VisionStage
from follower.flight.vision.tracker_factory import make_settings_detector, make_target_tracker
from follower.recording import FlightConfig, Recorder, open_flight
from follower.recording.run_folder import new_run_folder, write_boxes, write_setpoints
from follower.recording.telemetry_logs import (
    TelemetryError,
    TelemetryLog,
    TelemetryPlayback,
    read_telemetry,
)
from follower.settings.settings import Settings
from follower.ui.terminal.console import print_line
from follower_control.common.clock_offset import NoOverlapError, TimeOffset
from follower_control.common.strict_config import SettingsError
from follower_vision.clock import SimulatedClock
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import FrameSource, SourceError

OFFSET_PLOT = "offset.png"
_REPORT_EVERY = 30


def run_import(
    source: FrameSource,
    settings: Settings,
    selector: Selector,
    telemetry: TelemetryLog | None,
    log: FlightLog,
    clock: SimulatedClock,
    status: Status,
) -> bool:
    """Go through the video to its end; return whether the target was ever found.

    Args:
        source: at its beginning; where the size of its frames changes is an end, too.
        settings: all of them.
        selector: finds the target.
        telemetry: on the video's time; None if there is none.
        log: takes everything; the recorder's.
        clock: the log's and the frames'.
        status: shows how far the run has come.
    """
    stage = VisionStage(make_target_tracker(settings))
    stage.select(selector)
    vision = VisionLoop(stage, clock, log)
    control: RecordedControl | None = None
    has_position = telemetry is not None and bool(telemetry.positions)
    found = False
    frame = source.read()
    while frame is not None:
        following = source.read()
        if following is not None and following.image.shape != frame.image.shape:
            following = None
        clock.sleep_until(frame.captured_s)
        answer = vision.step(frame)
        vision.learn()
        found = found or answer.track is not None
        if control is None:
            playback = None
            if telemetry is not None:
                playback = TelemetryPlayback(telemetry, frame.captured_s).until
            control = RecordedControl(settings, log, frame, playback, has_position)
        control.step(answer, None if following is None else following.captured_s)
        if len(log.tracks) % _REPORT_EVERY == 0:
            status.update(f"Following the target, {frame.captured_s:.0f} s")
        frame = following
    return found


def _from_time(selector: TargetsSelector, at_s: float) -> Selector:
    """Return a selector of the first target that ignores frames before `at_s`."""

    def select(frame: Frame) -> Box | None:
        return next(iter(selector(frame)), None) if frame.captured_s >= at_s - 1e-6 else None

    return select


@dataclass(frozen=True, slots=True, eq=False)
class _Telemetry:
    """A log on the video's time.

    Attributes:
        log: with times as the video's.
        facts: how the offset came about, for the recording.
        found: how it was found; None if it was given.
    """

    log: TelemetryLog
    facts: dict[str, Any]
    found: TimeOffset | None


def import_video(
    source: VideoInput,
    settings: Settings,
    target: TargetChoice,
    at_s: float,
    telemetry: Path | None,
    offset_s: float | None,
    out: Path,
    console: Console | None = None,
) -> int:
    """Run the command and return its exit code.

    Args:
        source: the video.
        settings: of vision, control and the recorder.
        target: to follow.
        at_s: when it is chosen, in seconds from the video's beginning.
        telemetry: log of the flight, if there is one.
        offset_s: the log's time, in seconds, at the first frame; None finds it.
        out: takes the flight's folder.
        console: takes what is said.

    Raises:
        ValueError, OSError: what the user can mend, in one line. Nothing is left behind then but
            the plot that the message names, if it names one.
    """
    _check(source, target, at_s, telemetry, offset_s)
    console = console or Console()
    # As in a flight; and the number of threads must not decide about the last bit.
    cv2.setNumThreads(1)
    selector = _from_time(target.selector(make_settings_detector(settings)), at_s)
    log = None if telemetry is None else read_telemetry(telemetry)
    folder = new_run_folder(out, f"import-{source.short_name}")
    with ExitStack() as undo:
        undo.callback(shutil.rmtree, folder, ignore_errors=True)
        aligned = None
        if log is not None:
            aligned = _aligned(source, settings, log, offset_s, folder, console)
        if aligned is None or not aligned.log.positions:
            settings = recorded_settings(settings)
        run = {"source": source.name, "target": str(target), "command": command_line()}
        run["title"] = f"{source.short_name}, imported"
        facts = {} if aligned is None else {"telemetry": str(telemetry), "offset": aligned.facts}
        needs_telemetry = aligned is not None and bool(aligned.log.positions)
        config = FlightConfig.of(
            "video", settings, run={**run, **facts}, needs_telemetry=needs_telemetry
        )
        _record(source, config, settings, selector, aligned, folder, console)
        undo.pop_all()
    more = []
    if aligned is not None and aligned.found is not None:
        write_offset_plot(folder / OFFSET_PLOT, aligned.found)
        more.append(offset_section(aligned.found))
    inspect_recorded(open_flight(folder), console=console, more=more)
    return 0


def _check(
    source: VideoInput,
    target: TargetChoice,
    at_s: float,
    telemetry: Path | None,
    offset_s: float | None,
) -> None:
    """Refuse options that contradict each other.

    Raises:
        SettingsError: says what to do.
    """
    if source.is_live:
        raise SettingsError(f"{source.shown}: import takes a recording; live: `follower track`")
    if not target.given:
        raise SettingsError("which target? give --target x,y,w,h, --select person or --colour")
    if LIST in target.select:
        raise SettingsError("`follower track VIDEO --select list` lists what there is")
    if not (math.isfinite(at_s) and at_s >= 0):
        raise SettingsError(f"--at {at_s}: seconds from the video's beginning, from 0 on")
    if offset_s is not None and telemetry is None:
        raise SettingsError("--offset needs --telemetry: it is the time between the two")
    if offset_s is not None and not math.isfinite(offset_s):
        raise SettingsError(f"--offset {offset_s}: a finite number of seconds")


def _aligned(
    source: VideoInput,
    settings: Settings,
    log: TelemetryLog,
    offset_s: float | None,
    folder: Path,
    console: Console,
) -> _Telemetry:
    """Bring the log onto the video's time, by the offset given or found.

    Raises:
        SourceError: none was given, and the one found is not good enough.
    """
    if offset_s is not None:
        facts = {"seconds": offset_s, "given": "by hand"}
        return _Telemetry(log.moved(-offset_s), facts, None)
    with console.status("Measuring how the image turns"), source.open() as frames:
        first = frames.read()
        if first is None:
            raise SourceError(f"{source.name}: no frame could be read")
        camera = settings.camera.model_of(source.name, first.width, first.height)
        flows = list(corner_flows(iter(frames.read, None), camera))
    try:
        found = align(flows, log, settings.camera.mount)
    except NoOverlapError as error:
        raise SourceError(f"the time offset cannot be found: {error}; give --offset") from error
    print_line(
        console,
        f"Time offset {found.offset_s:.3f} s ± {1e3 * found.unsure_s:.1f} ms, correlation "
        f"{found.peak:.3f}, next best {found.second:.3f}; the image turns {found.scale:.2f} times "
        "as much as the gyro",
    )
    if found.problems:
        plot = folder.with_name(f"{folder.name}-{OFFSET_PLOT}")  # the run's folder goes away
        write_offset_plot(plot, found)
        raise SourceError(
            f"the time offset between {source.name} and the telemetry is not sure: "
            f"{'; '.join(found.problems)}. The best guess is {found.offset_s:.3f} s, {plot} shows "
            "it; give --offset SECONDS (the log's time at the video's first frame), or a part of "
            "the flight with turns in it"
        )
    return _Telemetry(log.moved(-found.offset_s), offset_facts(found), found)


def _record(
    source: VideoInput,
    config: FlightConfig,
    settings: Settings,
    selector: Selector,
    telemetry: _Telemetry | None,
    folder: Path,
    console: Console,
) -> None:
    """Run the pipeline and write the flight.

    Raises:
        SourceError: the target was never seen, or the video cannot be read.
    """
    log = None if telemetry is None else telemetry.log
    clock = SimulatedClock()
    with (
        console.status("Following the target") as status,
        source.open() as frames,
        Recorder(folder, config, clock, settings.recorder, threaded=False) as recorder,
    ):
        if log is not None:
            _check_overlap(frames, log)
        found = run_import(frames, settings, selector, log, recorder.log, clock, status)
        if log is not None:
            lasts = f"from {log.start_s:.1f} s to {log.end_s:.1f} s of the video's time"
            recorder.log.note(clock.now(), "telemetry", f"the log lasts {lasts}")
        if frames.problem is not None:
            recorder.log.note(clock.now(), "video", frames.problem)
    if not found:
        raise SourceError(
            f"{config.run['target']} was not seen in {len(recorder.log.tracks)} frames from --at on"
        )
    write_boxes(folder / "boxes.csv", recorder.log.tracks)
    write_setpoints(folder / "setpoints.csv", recorder.log.controls)
    for remark in recorder.remarks:
        print_line(console, remark)


def _check_overlap(source: FrameSource, log: TelemetryLog) -> None:
    """Refuse telemetry of another time.

    Raises:
        TelemetryError: it ends before the video begins, or begins after it ends.
    """
    frames = source.frame_count
    end_s = math.inf if frames is None else frames / max(source.nominal_rate_hz, 1e-3)
    if log.end_s < 0 or log.start_s > end_s:
        raise TelemetryError(
            f"with this offset the log lasts from {log.start_s:.1f} s to {log.end_s:.1f} s of the "
            "video's time, and nothing of it belongs to the video; give another --offset"
        )
