"""`follower track`: recorded video through the code that flies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from follower.flight_video import OverlayVideo
from follower.flightlog import FlightLog, TrackRecord
from follower.outputs import write_boxes, write_setpoints
from follower.recorded import RecordedRun
from follower.report.track_plot import write_track_plot
from follower.run_folder import new_run_folder
from follower.selecting import box_selector, colour_selector
from follower.settings import load_settings
from follower.vision_stage import Selector
from follower_control.strict_yaml import SettingsError
from follower_vision.box import Box
from follower_vision.framesource import FrameSource
from follower_vision.sources import open_source
from follower_vision.track import TrackState

_SUCCESS, _INTERRUPTED = 0, 130


@dataclass(frozen=True, slots=True)
class TrackOptions:
    """What the command line was given; see `follower track --help`."""

    source: str
    target: Box | None
    colour: str | None
    rate_hz: float
    save: Path | None
    boxes: Path | None
    config: Path | None
    overrides: tuple[str, ...]
    out: Path


def track_recording(options: TrackOptions) -> int:
    """Run the command and return its exit code."""
    settings = load_settings(options.config, overrides=options.overrides)
    selector = _selector(options)
    console = Console()
    with open_source(options.source, folder_rate_hz=options.rate_hz) as source:
        run = RecordedRun(settings, source, selector)
        folder = new_run_folder(options.out, f"track-{_short_name(options.source)}")
        video = options.save or folder / "track.mp4"
        completed = _run(run, source, video, console)
        files = [video, *_write_outputs(run.log, folder, options.boxes)]
        if source.problem is not None:
            console.print(f"[yellow]{source.problem}[/yellow]")
    _summarise(run.log, files, console)
    return _SUCCESS if completed else _INTERRUPTED


def _selector(options: TrackOptions) -> Selector:
    if options.target is not None:
        return box_selector(options.target)
    if options.colour is not None:
        return colour_selector(options.colour)
    raise SettingsError("which target? give --target x,y,w,h or --colour '#rrggbb'")


def _short_name(source: str) -> str:
    path = Path(source).resolve()
    name = path.parent.name if path.name == "img" else path.stem
    return "".join(c if c.isalnum() or c in "-_" else "-" for c in name)


def _run(run: RecordedRun, source: FrameSource, video: Path, console: Console) -> bool:
    """Return whether the run came to its end; the user's interrupt leaves what there is."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with (
        OverlayVideo(video, source.nominal_rate_hz) as overlay,
        Progress(*columns, console=console) as progress,
    ):
        task = progress.add_task("tracking", total=source.frame_count)

        def show(record: TrackRecord) -> None:
            progress.update(task, advance=1, description=_describe(record))

        try:
            run.run(overlay, show)
        except KeyboardInterrupt:
            return False
    return True


def _describe(record: TrackRecord) -> str:
    track = record.track
    if track is None:
        return "looking for the target"
    return f"{track.state:<8} {track.confidence:4.2f}  {1 / max(record.busy_s, 1e-6):5.0f} fps"


def _write_outputs(log: FlightLog, folder: Path, boxes: Path | None) -> list[Path]:
    files = [boxes or folder / "boxes.csv", folder / "setpoints.csv", folder / "track.png"]
    write_boxes(files[0], log.tracks)
    write_setpoints(files[1], log.controls)
    write_track_plot(files[2], log)
    return files


def _summarise(log: FlightLog, files: Sequence[Path], console: Console) -> None:
    states = [record.track.state for record in log.tracks if record.track is not None]
    seen = sum(state is TrackState.TRACKING for state in states)
    busy_s = sum(record.busy_s for record in log.tracks)
    console.print(
        f"{len(log.tracks)} frames, target seen in {seen} "
        f"({100 * seen / max(1, len(log.tracks)):.1f} %), "
        f"{len(log.tracks) / max(busy_s, 1e-9):.0f} frames a second"
    )
    for file in files:
        console.print(f"  {file}", highlight=False)
