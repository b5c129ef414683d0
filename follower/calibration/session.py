"""From a source of images to the lens's settings and a picture."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from follower.calibration.board import Board
from follower.calibration.display import counts_line, is_enough, shown
from follower.calibration.picture import picture
from follower.calibration.settings_file import settings_yaml
from follower.calibration.solving import Calibration, CalibrationError, calibrate
from follower.calibration.views import ViewCollection
from follower.interrupt import StopOnInterrupt
from follower.preflight.camera_checks import folds
from follower.print_line import print_line
from follower.report.writer import write_whole, write_whole_bytes
from follower.settings import load_settings, settings_data
from follower_control.strict_yaml import SettingsError
from follower_vision.connection import without_password
from follower_vision.frame import Frame
from follower_vision.framesource import FrameSource
from follower_vision.sources import is_live, open_source

_LOOK_EVERY_S = 0.3
_WORST_SHOWN = 3
_CALIBRATED, _NOT_CALIBRATED = 0, 1


@dataclass(frozen=True, slots=True)
class CalibrateOptions:
    """What the command line was given; see `follower calibrate --help`.

    Raises:
        SettingsError: the result would overwrite something.
    """

    source: str
    board: Board
    out: Path
    config: Path | None = None
    every_s: float = _LOOK_EVERY_S

    def __post_init__(self) -> None:
        for path in (self.out, self.picture):
            if path.exists():
                raise SettingsError(f"{path} exists already: move it, or give another --out")

    @property
    def picture(self) -> Path:
        """Where the picture goes."""
        return self.out.with_suffix(".png")


def run(options: CalibrateOptions) -> int:
    """Look at images, compute the lens, write it; return the exit code: 1 if there is none.

    Raises:
        SettingsError, SourceError, OSError: what the user can mend, in one line.
    """
    console = Console()
    cv2.setNumThreads(1)
    known, _ = settings_data(options.config)
    load_settings(options.config)
    views = _look(options, console)
    print_line(console, counts_line(views))
    if views.size is None or views.sample is None:
        print_line(console, _nothing_seen(views))
        return _NOT_CALIBRATED
    try:
        calibration = calibrate(views.views, views.size)
        _check(calibration)
    except CalibrationError as error:
        print_line(console, f"No calibration: {error}.")
        return _NOT_CALIBRATED
    _write(options, views, calibration, known)
    for line in report(calibration, options):
        print_line(console, line)
    return _CALIBRATED


def report(calibration: Calibration, options: CalibrateOptions) -> Iterator[str]:
    """Yield what came out, in lines."""
    lens = calibration.lens
    yield (
        f"focal length {lens.fx:.1f} px ({math.degrees(lens.horizontal_fov_rad):.1f}° across), "
        f"axis at {lens.cx:.1f}, {lens.cy:.1f}, distortion "
        f"{', '.join(f'{number:+.4f}' for number in lens.distortion)}"
    )
    worst = sorted(calibration.errors_px, key=lambda pair: -pair[1])[:_WORST_SHOWN]
    listed = ", ".join(f"image {number}: {error:.2f}" for number, error in worst)
    yield f"{calibration.error_px:.2f} px off over {len(calibration.views)} views; worst {listed}"
    if calibration.dropped:
        yield f"left out, for they do not fit: images {', '.join(map(str, calibration.dropped))}"
    for warning in calibration.warnings:
        yield f"could be better: {warning}"
    yield f"{options.out} has the lens: give it with -c, or copy its section `camera`"
    yield f"{options.picture} shows it: edges of the board must be straight on the right"


def _look(options: CalibrateOptions, console: Console) -> ViewCollection:
    """Go through the images until they end, there are enough views, or Ctrl-C."""
    views = ViewCollection(options.board)
    stopped = StopOnInterrupt()
    with open_source(options.source) as source, stopped:
        if not is_live(options.source):
            _look_at_recording(options, source, views, console, stopped)
            if source.problem:
                print_line(console, f"{options.source}: {source.problem}")
            return views
        console.print("Ctrl-C ends it and computes the lens.")
        with Live(console=console, auto_refresh=False) as live:
            for frame in _now_and_then(source, options.every_s, stopped):
                seen = _add(views, frame)
                live.update(shown(views, seen), refresh=True)
                if is_enough(views):
                    break
    return views


def _look_at_recording(
    options: CalibrateOptions,
    source: FrameSource,
    views: ViewCollection,
    console: Console,
    stopped: StopOnInterrupt,
) -> None:
    every_s = 0.0 if Path(options.source).is_dir() else options.every_s
    columns = (TextColumn("looking for the board"), BarColumn(), MofNCompleteColumn())
    bar = Progress(*columns, console=console, transient=True)
    with bar if console.is_terminal else nullcontext():
        task = bar.add_task("", total=source.frame_count)
        for frame in _now_and_then(source, every_s, stopped):
            _add(views, frame)
            bar.update(task, completed=frame.sequence + 1)


def _now_and_then(source: FrameSource, every_s: float, stopped: StopOnInterrupt) -> Iterator[Frame]:
    """Yield a frame each `every_s` of the source's time."""
    due_s = -math.inf
    while not stopped.interrupted and (frame := source.read()) is not None:
        if frame.captured_s >= due_s:
            due_s = frame.captured_s + every_s
            yield frame


def _add(views: ViewCollection, frame: Frame) -> bool:
    try:
        return views.add(frame.image) is not None
    except ValueError as error:
        raise SettingsError(str(error)) from None


def _nothing_seen(views: ViewCollection) -> str:
    if views.blurred:
        return (
            "No calibration: in every image that shows the board it is blurred. Hold it still, "
            "give it more light, focus the lens."
        )
    return (
        "No calibration: the board was never seen. Is it the one of --kind and --squares? "
        "`follower calibrate --board board.pdf` prints it; a chessboard has to be in view whole."
    )


def _check(calibration: Calibration) -> None:
    if folds(calibration.lens):
        raise CalibrationError(
            "the distortion found folds the image before its corners: show the board in the "
            "corners, too; a fisheye needs another lens model"
        )


def _write(
    options: CalibrateOptions,
    views: ViewCollection,
    calibration: Calibration,
    known: dict[str, Any],
) -> None:
    if views.sample is None:
        raise AssertionError("a calibration has views, and the largest one's image is kept")
    name = without_password(options.source)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(options.out, settings_yaml(calibration, options.board, name, known))
    _, png = cv2.imencode(".png", picture(calibration, views.sample))
    write_whole_bytes(options.picture, png.tobytes())
