"""`follower import`: from a video, and perhaps a log, to a flight's folder, setpoints, a report."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
from rich.console import Console
from rich.status import Status

from follower.importing.alignment import align, corner_flows
from follower.importing.options import ImportOptions
from follower.importing.run import from_time, run_import
from follower.inspection import prepared, print_summary, write_inspection
from follower.object_selector import ChoiceError, ObjectSelector, Wanted
from follower.outputs import write_boxes, write_setpoints
from follower.print_line import print_line
from follower.recorded import recorded_settings
from follower.recorder import FlightConfig, Recorder, open_flight
from follower.report.offset_plot import offset_facts, offset_section, write_offset_plot
from follower.run_folder import new_run_folder
from follower.selecting import box_selector, colour_selector
from follower.settings import Settings
from follower.telemetry import TelemetryError, TelemetryLog, read_telemetry
from follower.tracking import make_settings_detector
from follower.vision_stage import Selector
from follower_control.timeoffset import TimeOffset
from follower_vision.box import Box
from follower_vision.clock import SimulatedClock
from follower_vision.frame import Frame
from follower_vision.framesource import FrameSource, SourceError
from follower_vision.network import ModelError
from follower_vision.sources import open_source

OFFSET_PLOT = "offset.png"
_SUCCESS = 0
_TELL_EVERY = 30


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


def import_video(options: ImportOptions, console: Console | None = None) -> int:
    """Run the command and return its exit code.

    Raises:
        ValueError, OSError: what the user can mend, in one line. Nothing is left behind then but
            the plot that the message names, if it names one.
    """
    console = console or Console()
    # As in a flight; and the number of threads must not decide about the last bit.
    cv2.setNumThreads(1)
    settings = options.settings()
    selector = from_time(_selector(options, settings), options.at_s)
    log = None if options.telemetry is None else read_telemetry(options.telemetry)
    folder = new_run_folder(options.out, f"import-{_short_name(options.source)}")
    with _kept_if_whole(folder):
        telemetry = None if log is None else _aligned(options, settings, log, folder, console)
        _record(options, settings, selector, telemetry, folder, console)
    _report(telemetry, folder, console)
    return _SUCCESS


def _selector(options: ImportOptions, settings: Settings) -> Selector:
    if options.target is not None:
        return box_selector(options.target)
    if options.colour is not None:
        return colour_selector(options.colour)
    detector = make_settings_detector(settings)
    if detector is None:
        raise ModelError("--select needs a detector; name one by --detector")
    wanted = Wanted.parse(str(options.select), detector.class_names)
    objects = ObjectSelector([wanted], detector)

    def select(frame: Frame) -> Box | None:
        try:
            return next(iter(objects(frame)), None)
        except ChoiceError as error:
            raise SourceError(f"{error}; `follower track --select list` shows them") from error

    return select


def _aligned(
    options: ImportOptions, settings: Settings, log: TelemetryLog, folder: Path, console: Console
) -> _Telemetry:
    """Bring the log onto the video's time, by the offset given or found.

    Raises:
        SourceError: none was given, and the one found is not good enough.
    """
    if options.offset_s is not None:
        facts = {"seconds": options.offset_s, "given": "by hand"}
        return _Telemetry(log.moved(-options.offset_s), facts, None)
    with console.status("Measuring how the image turns"), _opened(options) as source:
        first = source.read()
        if first is None:
            raise SourceError(f"{options.source}: no frame could be read")
        camera = settings.camera.model_of(str(options.source), first.width, first.height)
        found = align(list(corner_flows(source, camera)), log, settings.camera.mount)
    _tell(found, console)
    if found.problems:
        plot = write_refused(folder, found)
        raise SourceError(
            f"the time offset between {options.source} and {options.telemetry} is not sure: "
            f"{'; '.join(found.problems)}. The best guess is {found.offset_s:.3f} s, {plot} shows "
            "it; give --offset SECONDS (the log's time at the video's first frame), or a part of "
            "the flight with turns in it"
        )
    return _Telemetry(log.moved(-found.offset_s), offset_facts(found), found)


def write_refused(folder: Path, found: TimeOffset) -> Path:
    """Write the plot of an offset that is refused, beside the run's folder, which goes away."""
    path = folder.with_name(f"{folder.name}-{OFFSET_PLOT}")
    write_offset_plot(path, found)
    return path


def _record(
    options: ImportOptions,
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
    settings = settings if log is not None and log.positions else recorded_settings(settings)
    clock = SimulatedClock()
    with (
        console.status("Following the target") as status,
        _opened(options) as source,
        Recorder(
            folder,
            _config(options, settings, telemetry),
            clock,
            settings.recorder,
            threaded=False,
        ) as recorder,
    ):
        _check_overlap(source, log)
        shown = _Shown(status)
        found = run_import(source, settings, selector, log, recorder.log, clock, shown)
        if log is not None:
            said = (
                f"the log lasts from {log.start_s:.1f} s to {log.end_s:.1f} s of the video's time"
            )
            recorder.log.note(clock.now(), "telemetry", said)
        if source.problem is not None:
            recorder.log.note(clock.now(), "video", source.problem)
    if not found:
        raise SourceError(f"{options.wish} was not seen in {shown.count} frames from --at on")
    write_boxes(folder / "boxes.csv", recorder.log.tracks)
    write_setpoints(folder / "setpoints.csv", recorder.log.controls)
    for remark in recorder.remarks:
        print_line(console, remark)


class _Shown:
    """Shows how far the run has come."""

    def __init__(self, status: Status) -> None:
        self._status = status
        self.count = 0

    def __call__(self, frame: Frame) -> None:
        """Count a frame; now and then, say so."""
        self.count += 1
        if self.count % _TELL_EVERY == 0:
            self._status.update(f"Following the target, {frame.captured_s:.0f} s")


def _check_overlap(source: FrameSource, log: TelemetryLog | None) -> None:
    """Refuse telemetry of another time.

    Raises:
        TelemetryError: it ends before the video begins, or begins after it ends.
    """
    if log is None:
        return
    frames = source.frame_count
    end_s = float("inf") if frames is None else frames / max(source.nominal_rate_hz, 1e-3)
    if log.end_s < 0 or log.start_s > end_s:
        raise TelemetryError(
            f"with this offset the log lasts from {log.start_s:.1f} s to {log.end_s:.1f} s of the "
            "video's time, and nothing of it belongs to the video; give another --offset"
        )


def _config(
    options: ImportOptions, settings: Settings, telemetry: _Telemetry | None
) -> FlightConfig:
    run: dict[str, Any] = {
        "title": f"{_short_name(options.source)}, imported",
        "source": options.source,
        "target": options.wish,
        "command": options.command,
    }
    has_position = False
    if telemetry is not None:
        run |= {"telemetry": str(options.telemetry), "offset": telemetry.facts}
        has_position = bool(telemetry.log.positions)
    return FlightConfig.of("video", settings, run=run, needs_telemetry=has_position)


def _report(telemetry: _Telemetry | None, folder: Path, console: Console) -> None:
    more = []
    if telemetry is not None and telemetry.found is not None:
        write_offset_plot(folder / OFFSET_PLOT, telemetry.found)
        more.append(offset_section(telemetry.found))
    recorded = open_flight(folder)
    flight = prepared(recorded)
    print_summary(console, recorded, flight, write_inspection(recorded, flight, more=more))


def _tell(found: TimeOffset, console: Console) -> None:
    print_line(
        console,
        f"Time offset {found.offset_s:.3f} s ± {1e3 * found.unsure_s:.1f} ms, correlation "
        f"{found.peak:.3f}, next best {found.second:.3f}; the image turns {found.scale:.2f} times "
        "as much as the gyro",
    )


def _opened(options: ImportOptions) -> FrameSource:
    return open_source(options.source, folder_rate_hz=options.rate_hz)


@contextmanager
def _kept_if_whole(folder: Path) -> Iterator[None]:
    """Remove the run's folder again if nothing comes of the run."""
    whole = False
    try:
        yield
        whole = True
    finally:
        if not whole:
            shutil.rmtree(folder, ignore_errors=True)


def _short_name(source: str) -> str:
    path = Path(source).resolve()
    name = path.parent.name if path.name == "img" else path.stem
    return re.sub(r"[^\w-]", "-", name)
