"""From a source of images to the lens's settings and a picture."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.text import Text

from follower.apps.calibrate.board import Board
from follower.apps.calibrate.solve import (
    COLUMNS,
    ROWS,
    CalibrationError,
    Coverage,
    LensCalibration,
    calibrate,
)
from follower.apps.calibrate.views import BoardView, ViewCollection
from follower.settings.settings import load_settings, settings_data
from follower.ui.terminal.console import print_line
from follower.ui.terminal.interrupt import StopOnInterrupt, run_watched
from follower_control.common.strict_config import SettingsError, merged
from follower_vision.disk import write_whole, write_whole_bytes
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.images.frame import Frame, Image
from follower_vision.sources.capture import CaptureSettings, without_password
from follower_vision.sources.frame_source import FrameSource
from follower_vision.sources.open import is_live, open_source

_WIDTH = 640
_DARK, _GREEN, _WHITE = (38, 32, 28), (96, 150, 60), (240, 240, 240)
_BAR = 34
_HALF_PIXEL = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])


def picture(calibration: LensCalibration, sample: Image) -> Image:
    """Return coverage on the left, an undistorted image on the right."""
    lens = calibration.lens
    height = round(_WIDTH * lens.height / lens.width)
    coverage = Coverage(calibration.views, (lens.width, lens.height))
    left = _coverage(calibration.views, coverage, lens, height)
    right = cv2.resize(undistorted(sample, lens), (_WIDTH, height), interpolation=cv2.INTER_AREA)
    titles = (
        f"{len(calibration.views)} views, {coverage.share:.0%} of the image, "
        f"{calibration.error_px:.2f} px off",
        f"without distortion: edges must be straight; focal length {lens.fx:.1f} px",
    )
    panels = [
        np.vstack([_title(text), np.asarray(image, np.uint8)])
        for text, image in zip(titles, (left, right), strict=True)
    ]
    return np.hstack(panels)


def undistorted(image: Image, lens: CameraModel) -> Image:
    """Return the image as a lens without distortion, and with its axis in the middle, sees it."""
    straight = CameraModel.from_fov(lens.width, lens.height, lens.horizontal_fov_rad)
    # OpenCV counts from the middle of the first pixel.
    seen, wanted = lens.matrix - _HALF_PIXEL, straight.matrix - _HALF_PIXEL
    straightened = cv2.undistort(image, seen, np.array(lens.distortion), None, wanted)
    return np.asarray(straightened, np.uint8)


def _coverage(
    views: tuple[BoardView, ...], coverage: Coverage, lens: CameraModel, height: int
) -> Image:
    drawn = np.full((height, _WIDTH, 3), _DARK, np.uint8)
    for row, column in np.argwhere(coverage.covered):
        corner = (column * _WIDTH // COLUMNS + 2, row * height // ROWS + 2)
        other = ((column + 1) * _WIDTH // COLUMNS - 2, (row + 1) * height // ROWS - 2)
        cv2.rectangle(drawn, corner, other, _GREEN, -1)
    for view in views:
        for x, y in view.seen.image_px * (_WIDTH / lens.width):
            cv2.circle(drawn, (int(x), int(y)), 2, _WHITE, -1, cv2.LINE_AA)
    return drawn


def _title(text: str) -> Image:
    bar = np.full((_BAR, _WIDTH, 3), _DARK, np.uint8)
    cv2.putText(bar, text, (8, 23), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _WHITE, 1, cv2.LINE_AA)
    return bar


GOOD_VIEWS, GOOD_COVERAGE = 20, 0.8
_TILTED_DEG, _TILTED_VIEWS = 15.0, 6
_FULL, _SOME, _NONE = "██", "▒▒", "··"


def is_enough(views: ViewCollection) -> bool:
    """Whether more views would add little."""
    return views.full or (len(views.views) >= GOOD_VIEWS and advice(views) == "")


def advice(views: ViewCollection) -> str:
    """Return what to show next, "" if nothing is missing but views."""
    if views.size is None or not views.views:
        return "show the board to the camera"
    coverage = Coverage(views.views, views.size)
    tilted = sum(view.tilt_deg > _TILTED_DEG for view in views.views)
    if coverage.share < GOOD_COVERAGE and (missing := coverage.missing()):
        return f"show it at the {missing[0]}"
    if tilted < _TILTED_VIEWS:
        return "tilt it by 30 degrees, to each side, and up and down"
    return ""


def counts_line(views: ViewCollection) -> str:
    """Return what was seen so far in a line."""
    return (
        f"{views.images} images: {len(views.views)} views kept, {views.known} like one of these, "
        f"{views.blurred} blurred, {views.without_board} without the board"
    )


def shown(views: ViewCollection, board_in_view: bool) -> Group:
    """Return the coverage as a picture of characters, the numbers, and what to do next."""
    rows = []
    if views.size is not None:
        for counts in Coverage(views.views, views.size).counts:
            cells = np.select([counts == 0, counts >= 3], [_NONE, _FULL], _SOME)
            rows.append(Text(" ".join(map(str, cells))))
    seen = "the board is in view" if board_in_view else "no board in view"
    todo = advice(views) or f"{max(0, GOOD_VIEWS - len(views.views))} views more, of any kind"
    return Group(*rows, Text(counts_line(views)), Text(f"{seen}; next: {todo}", style="bold"))


_MOUNT = """\
# How late its pictures are, `follower calibrate latency` finds; how the camera is mounted, no
# calibration does: camera.pitch_deg, roll_deg, yaw_deg; see docs/how-to/fly.md.
"""


def settings_yaml(
    calibration: LensCalibration, board: Board, source: str, known: Mapping[str, Any]
) -> str:
    """Return a settings file with the lens in it.

    Args:
        calibration: what came out.
        board: that was seen.
        source: of the images, for the comment.
        known: settings that go into it as they are, but for the lens.
    """
    square_mm = 1e3 * board.square_m
    head = (
        f"# A lens as `follower calibrate` found it with {len(calibration.views)} views of a "
        f"{board.kind} board\n# of {board.across} x {board.down} squares of {square_mm:g} mm, from "
        f"{source}.\n"
        f"# Corners lie {calibration.error_px:.2f} px from where they should be; the focal length "
        f"is good to {max(calibration.focal_doubt, 1e-4):.2%}.\n"
    )
    lens = calibration.lens
    camera = {
        "focal_px": round(lens.fx, 3),
        "focal_width_px": lens.width,
        "center_px": [round(lens.cx, 3), round(lens.cy, 3)],
        "distortion": [round(number, 6) for number in lens.distortion],
        "frame_size": [lens.width, lens.height],
    }
    settings = merged(known, {"camera": camera})
    mounted = {"pitch_deg", "roll_deg", "yaw_deg", "latency_s"} & set(known.get("camera", {}))
    body = yaml.safe_dump(settings, sort_keys=False, default_flow_style=None)
    return head + ("" if mounted else _MOUNT) + str(body)


_WORST_SHOWN = 3
_CALIBRATED, _NOT_CALIBRATED = 0, 1


def run(
    source: str, board: Board, out: Path, config: Path | None = None, every_s: float = 0.3
) -> int:
    """Find the board in images, compute the lens, write it; return the exit code: 1 without one.

    Args:
        source: of the images.
        board: to look for.
        out: where the settings with the lens go; a picture goes beside them.
        config: settings file whose settings go there, too.
        every_s: one frame is looked at in so many seconds; all of a folder's.

    Raises:
        SettingsError, SourceError, OSError: what the user can mend, in one line.
    """
    drawing = picture_beside(out)
    console = Console()
    cv2.setNumThreads(1)
    known, _ = settings_data(config)
    capture = load_settings(config).camera.capture
    views = ViewCollection(board)
    _collect(views, source, capture, every_s, console)
    print_line(console, counts_line(views))
    if views.size is None or views.sample is None:
        print_line(console, _nothing_seen(views))
        return _NOT_CALIBRATED
    try:
        calibration = calibrate(views.views, views.size)
    except CalibrationError as error:
        print_line(console, f"No calibration: {error}.")
        return _NOT_CALIBRATED
    out.parent.mkdir(parents=True, exist_ok=True)
    write_whole(out, settings_yaml(calibration, board, without_password(source), known))
    _, png = cv2.imencode(".png", picture(calibration, views.sample))
    write_whole_bytes(drawing, png.tobytes())
    for line in report(calibration):
        print_line(console, line)
    print_line(console, f"{out} has the lens: give it with -c, or copy its section `camera`")
    print_line(console, f"{drawing} shows it: edges of the board must be straight on the right")
    return _CALIBRATED


def picture_beside(out: Path) -> Path:
    """Return where the picture of a calibration goes.

    Raises:
        SettingsError: the settings or the picture are there already.
    """
    drawing = out.with_suffix(".png")
    for path in (out, drawing):
        if path.exists():
            raise SettingsError(f"{path} exists already: move it, or give another --out")
    return drawing


def report(calibration: LensCalibration) -> Iterator[str]:
    """Yield what came out, in lines."""
    lens = calibration.lens
    yield (
        f"focal length {lens.fx:.1f} px ({math.degrees(lens.horizontal_fov_rad):.1f}° across), "
        f"axis at {lens.cx:.1f}, {lens.cy:.1f}, distortion "
        f"{', '.join(f'{number:+.4f}' for number in lens.distortion)}"
    )
    errors = {v.number: e for v, e in zip(calibration.views, calibration.errors_px, strict=True)}
    worst = sorted(errors, key=errors.__getitem__, reverse=True)[:_WORST_SHOWN]
    listed = ", ".join(f"image {number}: {errors[number]:.2f}" for number in worst)
    yield f"{calibration.error_px:.2f} px off over {len(calibration.views)} views; worst {listed}"
    if calibration.dropped:
        yield f"left out, for they do not fit: images {', '.join(map(str, calibration.dropped))}"
    for warning in calibration.warnings:
        yield f"could be better: {warning}"


def _collect(
    views: ViewCollection,
    source: str,
    capture: CaptureSettings,
    every_s: float,
    console: Console,
) -> None:
    """Go through the images until they end, there are enough views, or Ctrl-C."""
    with open_source(source, capture=capture) as frames:
        if is_live(source):
            _watch(views, frames, every_s, console)
            return
        columns = (TextColumn("looking for the board"), BarColumn(), MofNCompleteColumn())
        bar = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
        with bar, StopOnInterrupt() as stopped:
            task = bar.add_task("", total=frames.frame_count)
            for frame in _now_and_then(frames, 0.0 if Path(source).is_dir() else every_s):
                views.add(frame.image)
                bar.update(task, completed=frame.sequence + 1)
                if stopped.interrupted:
                    break
        if frames.problem:
            print_line(console, f"{source}: {frames.problem}")


def _watch(views: ViewCollection, camera: FrameSource, every_s: float, console: Console) -> None:
    """Look at a camera's frames; while none come, say why."""
    console.print("Ctrl-C ends it and computes the lens.")
    with Live(console=console, auto_refresh=False) as live:

        def look() -> None:
            for frame in _now_and_then(camera, every_s):
                live.update(shown(views, views.add(frame.image) is not None), refresh=True)
                if is_enough(views):
                    return

        def say_problem() -> None:
            if camera.problem:
                live.update(Text(camera.problem, style="red"), refresh=True)

        run_watched(look, say_problem, camera.close)


def _now_and_then(source: FrameSource, every_s: float) -> Iterator[Frame]:
    """Yield a frame each `every_s` of the source's time."""
    due_s = -math.inf
    while (frame := source.read()) is not None:
        if frame.captured_s >= due_s:
            due_s = frame.captured_s + every_s
            yield frame


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
