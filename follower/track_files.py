"""The files that `follower track` leaves behind."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from follower.flightlog import FlightLog
from follower.outputs import write_boxes, write_setpoints, write_target_boxes
from follower.report.track_plot import write_targets_plot, write_track_plot
from follower.run_folder import new_run_folder
from follower.track_options import TrackOptions
from follower_control.strict_yaml import SettingsError
from follower_vision.connection import without_password
from follower_vision.sources import is_live


@dataclass(frozen=True, slots=True)
class TrackFiles:
    """Where everything of one run goes; the folder exists.

    Attributes:
        folder: the run's own.
        video: with overlay; None if it is not wanted.
        boxes: the boxes (CSV).
    """

    folder: Path
    video: Path | None
    boxes: Path

    @classmethod
    def make(cls, options: TrackOptions) -> TrackFiles:
        """Make the run's folder.

        Raises:
            OSError: it cannot be made.
        """
        folder = run_folder(options)
        video = (options.save or folder / "track.mp4") if options.video else None
        return cls(folder, video, options.boxes or folder / "boxes.csv")

    def write(self, logs: Sequence[FlightLog]) -> list[Path]:
        """Write all but the video; return all files there are, the video first.

        Args:
            logs: one for each target; setpoints are the first one's, if it has any.

        Raises:
            OSError: a file cannot be written.
        """
        plot = self.folder / "track.png"
        if len(logs) == 1:
            write_boxes(self.boxes, logs[0].tracks)
            write_track_plot(plot, logs[0])
        else:
            write_target_boxes(self.boxes, [log.tracks for log in logs])
            write_targets_plot(plot, logs)
        files = [self.boxes, plot]
        if logs[0].controls:
            files.append(self.folder / "setpoints.csv")
            write_setpoints(files[-1], logs[0].controls)
        return files if self.video is None else [self.video, *files]


def check_destinations(options: TrackOptions) -> None:
    """Refuse at once what could not be written at the end, or would overwrite what is needed.

    Raises:
        SettingsError: says which option, and what to give instead.
    """
    if options.out.exists() and not options.out.is_dir():
        raise SettingsError(f"--out {options.out}: this is a file; give a folder")
    for option, path, suffix in (("--save", options.save, ".mp4"), ("--boxes", options.boxes, "")):
        if path is not None:
            _check_file(f"{option} {path}", path, suffix, Path(options.source))
    if options.save and options.boxes and _same(options.save, options.boxes):
        raise SettingsError(f"--save and --boxes are both {options.save}; give two names")


def run_folder(options: TrackOptions) -> Path:
    """Make and return a new folder, named after the source.

    Raises:
        OSError: it cannot be made.
    """
    return new_run_folder(options.out, f"track-{_short_name(options.source)}")


def _check_file(named: str, path: Path, suffix: str, source: Path) -> None:
    if path.is_dir():
        raise SettingsError(f"{named}: this is a folder; give a file's name")
    if not path.parent.is_dir():
        raise SettingsError(f"{named}: there is no folder {path.parent}; make it first")
    if suffix and path.suffix.lower() != suffix:
        raise SettingsError(f"{named}: an MP4 is written; give a name that ends in {suffix}")
    if source.exists() and _same(path, source):
        raise SettingsError(f"{named}: that is the source itself; give another name")


def _same(one: Path, other: Path) -> bool:
    return one.resolve() == other.resolve()


def _short_name(source: str) -> str:
    if is_live(source):
        shown = without_password(source).removeprefix("/dev/")
        return re.sub(r"[^A-Za-z0-9]+", "-", shown).strip("-")[:40]
    path = Path(source).resolve()
    name = path.parent.name if path.name == "img" else path.stem
    return re.sub(r"[^\w-]", "-", name)
