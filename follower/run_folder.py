"""A new folder for each run."""

from __future__ import annotations

import itertools
import shutil
from contextlib import suppress
from pathlib import Path


def new_run_folder(base: Path, name: str) -> Path:
    """Make and return `base/name`, or `base/name-2`, `-3`, … where that exists already.

    Raises:
        OSError: the folder cannot be made.
    """
    base.mkdir(parents=True, exist_ok=True)
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
