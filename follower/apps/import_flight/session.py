"""`follower import`: from a video, a log or both to a flight's folder, setpoints, a report."""

import math
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from follower.apps.import_flight.alignment import (
    align,
    flows_of,
    offset_facts,
    offset_section,
    write_offset_plot,
)
from follower.apps.import_flight.inputs import telemetry_of
from follower.apps.inspect import inspect_recorded
from follower.apps.target_choice import LIST, TargetChoice
from follower.apps.video_input import UntilResized, VideoInput, gaps_said
from follower.flight.control.offline import RecordedControl, recorded_settings
from follower.flight.log import FlightLog, noting_failed_plugins
from follower.flight.target.selectors import Selector, TargetsSelector
from follower.flight.threads import VisionLoop
from follower.flight.vision.stage import VisionStage
from follower.flight.vision.tracker_factory import make_settings_detector, make_target_tracker
from follower.recording import FlightConfig, Recorder, open_flight
from follower.recording.run_folder import (
    new_run_folder,
    remove_run_folder,
    write_boxes,
    write_setpoints,
)
from follower.recording.telemetry_logs import (
    TelemetryError,
    TelemetryLog,
    TelemetryPlayback,
)
from follower.settings.settings import Settings
from follower.ui.terminal.cli_options import typed_command
from follower.ui.terminal.console import print_line
from follower.ui.terminal.interrupt import StopOnInterrupt, stop_signals
from follower_control.common.clock_offset import NoOverlapError, TimeOffset
from follower_control.common.strict_config import SettingsError
from follower_vision.clock import SimulatedClock
from follower_vision.geometry.box import Box
from follower_vision.geometry.line_of_sight import CameraMount
from follower_vision.images.frame import Frame
from follower_vision.sources.frame_source import FrameSource, SourceError

OFFSET_PLOT = "offset.png"
_SUCCESS, _INTERRUPTED = 0, 130
_KEPT = 1000
"""So many records stay in memory while the flight is written, which may last for hours."""
_MOST_FLOWS = 18_000
"""The offset is found from so many frames at the beginning: ten minutes of 30 a second."""
_LENS_WIDTH_PX = 1920
_NO_VIDEO = (480, 640, 3)
_STEP_S = 1.0


def run_import(
    frames: UntilResized,
    settings: Settings,
    selector: Selector | None,
    telemetry: TelemetryLog | None,
    log: FlightLog,
    clock: SimulatedClock,
    advance: Callable[[], object],
    stopped: Callable[[], bool],
) -> bool:
    """Go through the video until its end or a stop; return whether the target was ever found.

    Args:
        frames: of the video, from its beginning.
        settings: all of them.
        selector: finds the target; None follows nothing.
        telemetry: on the video's time; None if there is none.
        log: takes everything; the recorder's.
        clock: the log's and the frames'.
        advance: is called after each frame.
        stopped: tells whether to end after this frame.
    """
    stage = VisionStage(make_target_tracker(settings))
    if selector is not None:
        stage.select(selector)
    vision = VisionLoop(stage, clock, log)
    control: RecordedControl | None = None
    found = False
    frame = frames.read()
    while frame is not None:
        following = None if stopped() else frames.read()
        clock.sleep_until(frame.captured_s)
        answer = vision.step(frame)
        found = found or answer.track is not None
        control = control or _control(settings, log, frame, telemetry)
        control.step(answer, None if following is None else following.captured_s)
        advance()
        frame = following
    return found


def run_without_video(
    settings: Settings,
    telemetry: TelemetryLog,
    log: FlightLog,
    clock: SimulatedClock,
    progress: Progress,
    stopped: Callable[[], bool],
) -> None:
    """Step control through telemetry to which there is no video, until its end or a stop."""
    nothing = Frame(np.zeros(_NO_VIDEO, np.uint8), telemetry.start_s, 0)
    control = _control(settings, log, nothing, telemetry)
    steps = np.arange(telemetry.start_s, telemetry.end_s, _STEP_S).tolist()
    for now_s in progress.track(steps, description="Importing"):
        if stopped():
            return
        until_s = min(now_s + _STEP_S, telemetry.end_s)
        control.step(None, until_s)
        clock.sleep_until(until_s)


def _control(
    settings: Settings, log: FlightLog, first: Frame, telemetry: TelemetryLog | None
) -> RecordedControl:
    if telemetry is None:
        return RecordedControl(settings, log, first)
    playback = TelemetryPlayback(telemetry, first.captured_s).until
    return RecordedControl(settings, log, first, playback, telemetry.has_motion)


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
    source: VideoInput | None,
    settings: Settings,
    target: TargetChoice,
    at_s: float,
    telemetry: Path | None,
    offset_s: float | None,
    out: Path,
    console: Console | None = None,
    *,
    lens_given: bool = True,
) -> int:
    """Run the command and return its exit code.

    Args:
        source: the video; None if there is only a log.
        settings: of vision, control and the recorder.
        target: to follow; none if there is telemetry.
        at_s: when it is chosen, in seconds from the video's beginning.
        telemetry: log of the flight; None takes what the video has with it.
        offset_s: the log's time, in seconds, at the first frame; None finds it.
        out: takes the flight's folder.
        console: takes what is said.
        lens_given: the settings' lens is the camera's; else that of the telemetry counts.

    Raises:
        ValueError, OSError: what the user can mend, in one line. Nothing is left behind then but
            the plot that the message names, if it names one, and a flight that is recorded already.
    """
    _check(source, target, at_s)
    console = console or Console()
    # As in a flight; and the number of threads must not decide about the last bit.
    cv2.setNumThreads(1)
    log, log_name = telemetry_of(source, telemetry)
    _check_telemetry(source, target, log, offset_s)
    if log is not None:
        if log.problem is not None:
            print_line(console, f"{log_name}: {log.problem}.")
        settings = _with_camera_of(log, settings, lens_given)
    selector = None
    if target.given:
        selector = _from_time(target.selector(make_settings_detector(settings)), at_s)
    name = Path(log_name).stem if source is None else source.short_name
    folder = new_run_folder(out, f"import-{name}")
    with stop_signals(), ExitStack() as undo:
        undo.callback(remove_run_folder, folder)
        aligned = None
        if log is not None:
            aligned = _aligned(source, settings, log, offset_s, folder, console)
        has_motion = aligned is not None and aligned.log.has_motion
        if not has_motion:
            settings = recorded_settings(settings)
        run: dict[str, Any] = {
            "source": log_name if source is None else source.name,
            "target": str(target),
            "command": typed_command(),
            "title": f"{name}, imported",
        }
        if aligned is not None:
            run |= {"telemetry": log_name, "offset": aligned.facts}
        config = FlightConfig.of("video", settings, run=run, needs_telemetry=has_motion)
        with StopOnInterrupt() as asked:
            inputs = config, settings, selector, aligned
            if not _record(source, *inputs, folder, console, lambda: asked.interrupted):
                return _INTERRUPTED
            undo.pop_all()
            _write_files(folder, aligned, console)
    return _INTERRUPTED if asked.interrupted else _SUCCESS


def _write_files(folder: Path, aligned: _Telemetry | None, console: Console) -> None:
    """Write all but the recording, and print the report's summary."""
    recorded = open_flight(folder)
    write_boxes(folder / "boxes.csv", recorded.log.tracks)
    write_setpoints(folder / "setpoints.csv", recorded.log.controls)
    more = []
    if aligned is not None and aligned.found is not None:
        write_offset_plot(folder / OFFSET_PLOT, aligned.found)
        more.append(offset_section(aligned.found))
    inspect_recorded(recorded, console=console, more=more)


def _check(source: VideoInput | None, target: TargetChoice, at_s: float) -> None:
    """Refuse options that contradict each other.

    Raises:
        SettingsError: says what to do.
    """
    if source is not None and source.is_live:
        raise SettingsError(f"{source.shown}: import takes a recording; live: `follower track`")
    if source is None and target.given:
        raise SettingsError("a target needs the flight's video: name it beside the telemetry")
    if LIST in target.select:
        raise SettingsError("`follower track VIDEO --select list` lists what there is")
    if not (math.isfinite(at_s) and at_s >= 0):
        raise SettingsError(f"--at {at_s}: seconds from the video's beginning, from 0 on")


def _check_telemetry(
    source: VideoInput | None,
    target: TargetChoice,
    log: TelemetryLog | None,
    offset_s: float | None,
) -> None:
    """Refuse what the telemetry, or its lack, makes meaningless; raises as `_check` does."""
    if log is None and not target.given:
        if source is not None:
            source.open().close()  # which says what is wrong with it, if something is
        raise SettingsError(
            "which target? give --target x,y,w,h, --select person or --colour; only a recording "
            "with telemetry is imported without one"
        )
    if offset_s is not None and (log is None or source is None):
        raise SettingsError(
            "--offset needs --telemetry, or a video with its own: it is the time between the two"
        )
    if offset_s is not None and not math.isfinite(offset_s):
        raise SettingsError(f"--offset {offset_s}: a finite number of seconds")


def _with_camera_of(log: TelemetryLog, settings: Settings, lens_given: bool) -> Settings:
    """Return the settings with the gimbal, and if nobody gave one, the lens of the telemetry."""
    changed: dict[str, Any] = {}
    if log.gimbals and log.attitudes:
        changed["gimbal"] = replace(settings.gimbal, enabled=True)
    lens = dict(log.lens)
    if log.fov_deg is not None:
        focal_px = _LENS_WIDTH_PX / 2 / math.tan(math.radians(log.fov_deg) / 2)
        lens = {"focal_px": min(max(focal_px, 1.0), 1e5), "focal_width_px": _LENS_WIDTH_PX}
    if lens and not lens_given:
        changed["camera"] = replace(settings.camera, **lens)
    return settings.model_copy(update=changed)


def _aligned(
    source: VideoInput | None,
    settings: Settings,
    log: TelemetryLog,
    offset_s: float | None,
    folder: Path,
    console: Console,
) -> _Telemetry:
    """Bring the log onto the video's time, by the offset given or found.

    What was recorded with the video keeps its own times where none can be found.

    Raises:
        SourceError: none was given, and the one found is not good enough.
    """
    if source is None:
        return _Telemetry(log.moved(-log.start_s), {"seconds": 0.0, "given": "no video"}, None)
    if offset_s is not None:
        facts = {"seconds": offset_s, "given": "by hand"}
        return _Telemetry(log.moved(-offset_s), facts, None)
    held = log.of_camera()
    try:
        found = _found_offset(source, settings, held, held is not log, console)
    except NoOverlapError as error:
        if not log.on_video_clock:
            said = f"the time offset cannot be found: {error}; give --offset"
            raise SourceError(said) from error
        return _kept(log, str(error), console)
    if found.problems and log.on_video_clock:
        return _kept(log, "; ".join(found.problems), console)
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


def _kept(log: TelemetryLog, why: str, console: Console) -> _Telemetry:
    said = f"The time offset cannot be told ({why}): it is left at 0, the recording's own times"
    print_line(console, said)
    return _Telemetry(log, {"seconds": 0.0, "not told": why}, None)


def _found_offset(
    source: VideoInput, settings: Settings, log: TelemetryLog, in_gimbal: bool, console: Console
) -> TimeOffset:
    """Compare the image's turns with the log's.

    Raises:
        NoOverlapError: too little is seen, or one of the two is too short.
        SourceError: no frame can be read.
    """
    if not len(log.rates.start_s):
        raise NoOverlapError("the telemetry tells no turns")
    with source.open() as frames, _progress(console) as progress:
        flows = islice(flows_of(iter(frames.read, None), source.name, settings), _MOST_FLOWS)
        seen = progress.track(flows, frames.frame_count, description="How the image turns")
        mount = CameraMount() if in_gimbal else settings.camera.mount
        return align(list(seen), log, mount)


def _progress(console: Console) -> Progress:
    columns = TextColumn("{task.description}"), BarColumn(), TimeRemainingColumn()
    return Progress(*columns, console=console, transient=True, disable=not console.is_terminal)


def _record(
    source: VideoInput | None,
    config: FlightConfig,
    settings: Settings,
    selector: Selector | None,
    telemetry: _Telemetry | None,
    folder: Path,
    console: Console,
    stopped: Callable[[], bool],
) -> bool:
    """Run the pipeline and write the flight; return False if it was stopped before there was any.

    Raises:
        SourceError: the target was never seen, or the video cannot be read.
    """
    log = None if telemetry is None else telemetry.log
    clock = SimulatedClock()
    said: list[str] = []
    with (
        ExitStack() as opened,
        _progress(console) as progress,
        Recorder(folder, config, clock, settings.recorder, threaded=False, kept=_KEPT) as recorder,
        noting_failed_plugins(recorder.log, clock.now),
    ):
        if source is not None:
            video = opened.enter_context(source.open())
            if log is not None:
                _check_overlap(video, log)
            task = progress.add_task("Importing", total=video.frame_count)
            frames = UntilResized(video)
            inputs = settings, selector, log, recorder.log, clock
            found = run_import(frames, *inputs, partial(progress.advance, task), stopped)
            if selector is not None and not found:
                if stopped():
                    waited_for = config.run["target"]
                    print_line(console, f"Ended while waiting for {waited_for}: nothing is written")
                    return False
                raise SourceError(
                    f"{config.run['target']} was not seen in any frame from --at on; the recording "
                    f"ends at {clock.now():.1f} s"
                )
            said += gaps_said(recorder.log)
            if frames.problem is not None:
                recorder.log.note(clock.now(), "video", frames.problem)
                said.append(frames.problem)
        elif log is not None:
            run_without_video(settings, log, recorder.log, clock, progress, stopped)
        if stopped():
            recorder.log.note(clock.now(), "import", "ended early, as the user asked")
        if log is not None:
            lasts = f"from {log.start_s:.1f} s to {log.end_s:.1f} s of the video's time"
            for remark in (f"the log lasts {lasts}", log.problem):
                if remark is not None:
                    recorder.log.note(clock.now(), "telemetry", remark)
    for remark in (*said, *recorder.remarks):
        print_line(console, remark)
    return True


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
