"""The rows of a campaign on disk: one line a finished run, never lost, never half."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from follower_control.strict_yaml import SettingsError

ROWS = "runs.jsonl"


class Store:
    """Appends rows to a file; each is on the disk when `add` returns.

    Args:
        folder: is made where it does not exist; only one campaign at a time may write into it.

    Raises:
        SettingsError: another one does.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / ROWS
        self._file = self.path.open("ab")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._file.close()
            said = f"{folder}: a campaign is running there; give another --out"
            raise SettingsError(said) from None
        self.rows = read_rows(self.path)
        if not _ends_in_line(self.path):
            self._file.write(b"\n")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    def add(self, row: Mapping[str, Any]) -> None:
        """Keep a run's row; one of the same key takes the last one's place."""
        line = json.dumps(row, allow_nan=False, separators=(",", ":")) + "\n"
        self._file.write(line.encode("utf-8"))
        self._file.flush()
        os.fsync(self._file.fileno())
        self.rows[str(row["key"])] = dict(row)


def read_rows(path: Path) -> dict[str, dict[str, Any]]:
    """Return the rows of a file by their keys; a line that is cut off or no row is left out."""
    rows: dict[str, dict[str, Any]] = {}
    if not path.exists():
        return rows
    for line in path.read_bytes().splitlines():
        try:
            row = json.loads(line)
        except ValueError:  # the computer stopped while it was written
            continue
        if isinstance(row, dict) and {"key", "error"} <= set(row):
            rows[str(row["key"])] = row
    return rows


def _ends_in_line(path: Path) -> bool:
    with path.open("rb") as file:
        if file.seek(0, os.SEEK_END) == 0:
            return True
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"
