"""A new folder for each run."""

import csv
import io
import itertools
import os
import shutil
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path

from follower.flight.log import ControlRecord, TrackRecord
from follower_control.common.strict_config import SettingsError
from follower_vision.disk import is_no_room, room_said, write_whole


def check_goes_on(folder: Path, what: str, *marks: str) -> None:
    """Refuse to go on in a folder that holds something else, whose files would be overwritten.

    Args:
        folder: may be empty, or not be there.
        what: has to have been begun there, for the message.
        marks: names of which one is in each such folder.

    Raises:
        SettingsError: it holds something else.
    """
    names = {path.name for path in folder.iterdir()} if folder.is_dir() else set[str]()
    if names and names.isdisjoint(marks):
        raise SettingsError(f"{folder}: no {what} was begun there ({marks[0]} is missing)")


_LONGEST_NAME = 200
"""Bytes of a run's name; a file system takes 255, and files beside the run are named by it."""


def new_run_folder(base: Path, name: str) -> Path:
    """Make and return `base/name`, or `base/name-2`, `-3`, … where that exists already.

    A name of more than 200 bytes is cut off there.

    Raises:
        SettingsError: a file is in its way.
        OSError: the folder cannot be made.
    """
    try:
        base.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError, FileNotFoundError):
        raise SettingsError(f"--out {base}: no folder can be made there; name another") from None
    while len(os.fsencode(name)) > _LONGEST_NAME:
        name = name[:-1]
    for number in itertools.count(1):
        folder = base / (name if number == 1 else f"{name}-{number}")
        try:
            folder.mkdir()
        except FileExistsError:
            continue
        return folder
    raise AssertionError("counting does not end")


def remove_run_folder(folder: Path) -> None:
    """Remove a run that came to nothing, and the folder of all runs if there is none in it.

    Raises:
        OSError: the run's folder cannot be removed.
    """
    shutil.rmtree(folder)
    with suppress(OSError):  # other runs are in it
        folder.parent.rmdir()


class RunFiles:
    """Writes what belongs to a run when that is over; what finds no room is a remark, no error.

    Attributes:
        missing: names of the files that were not written.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.missing: list[str] = []

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is missing in the folder, in a sentence; nothing, usually."""
        if not self.missing:
            return ()
        said = f"No room for {', '.join(self.missing)} ({room_said(self._folder)})"
        return (f"{said}; `follower inspect` reports elsewhere on what was recorded.",)

    def write(self, name: str, write: Callable[[Path], object]) -> None:
        """Have a file written, or note that there is no room for it.

        Args:
            name: of the file in the folder.
            write: is called with the file's path.

        Raises:
            OSError: it cannot be written for another reason.
        """
        try:
            write(self._folder / name)
        except OSError as error:
            if not is_no_room(error):
                raise
            self.missing.append(name)


BOX_COLUMNS = ("frame", "time", "x", "y", "w", "h", "state", "confidence", "produced_by")
SETPOINT_COLUMNS = (
    *("time", "state", "reason"),
    *("asked_forward_m_s", "asked_right_m_s", "asked_down_m_s", "asked_yaw_rate_rad_s"),
    *("forward_m_s", "right_m_s", "down_m_s", "yaw_rate_rad_s"),
    *("limits", "sent"),
)


def write_boxes(path: Path, tracks: Iterable[TrackRecord]) -> None:
    """Write one line a frame: number, seconds, box in pixels, state, confidence, producer."""
    _write_csv(path, BOX_COLUMNS, (_box_row(record) for record in tracks))


def write_target_boxes(path: Path, targets: Sequence[Sequence[TrackRecord]]) -> None:
    """Write the boxes of several targets: one line a frame and target, with its number last.

    Args:
        path: the file.
        targets: each target's records; all of the same frames.
    """
    rows = (
        (*_box_row(record), number)
        for frame in zip(*targets, strict=True)
        for number, record in enumerate(frame, 1)
    )
    _write_csv(path, (*BOX_COLUMNS, "target"), rows)


def write_setpoints(path: Path, controls: Iterable[ControlRecord]) -> None:
    """Write one line a control step: what was asked, what was allowed, and what limited it."""
    _write_csv(path, SETPOINT_COLUMNS, (_setpoint_row(record) for record in controls))


def _write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    writer.writerow(columns)
    writer.writerows(rows)
    write_whole(path, text.getvalue())


def _box_row(record: TrackRecord) -> Sequence[object]:
    head = (record.sequence, f"{record.captured_s:.6f}")
    track = record.track
    if track is None:
        return (*head, "", "", "", "", "none", "", "")
    box = (f"{value:.3f}" for value in track.box.xywh)
    return (*head, *box, str(track.state), f"{track.confidence:.4f}", track.produced_by)


def _setpoint_row(record: ControlRecord) -> Sequence[object]:
    numbers = (f"{value:.6f}" for value in (*record.asked.values, *record.allowed.values))
    limits = "|".join(record.limits)
    head = (f"{record.time_s:.6f}", str(record.state), str(record.reason))
    return (*head, *numbers, limits, int(record.sent))
