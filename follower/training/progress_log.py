"""A training's figures as a CSV file that grows a row at a time."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path


class ProgressLog:
    """Appends rows; after a resumption, rows of later steps are dropped.

    Args:
        path: the file.
        columns: the figures' names; `step` stands before them.
        resumed_at: the step that the training goes on from, 0 begins anew.
    """

    def __init__(self, path: Path, columns: tuple[str, ...], resumed_at: int = 0) -> None:
        self._path = path
        self._columns = ("step", *columns)
        rows = _rows(path, resumed_at) if resumed_at else []
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, self._columns, extrasaction="ignore")
            writer.writeheader()
            writer.writerows(rows)

    def add(self, step: int, figures: Mapping[str, float | None]) -> None:
        """Write the figures known at a step; those missing are left empty."""
        row = {name: _text(value) for name, value in figures.items()}
        with self._path.open("a", newline="", encoding="utf-8") as file:
            csv.DictWriter(file, self._columns).writerow({"step": step, **row})


def _rows(path: Path, last_step: int) -> list[dict[str, str]]:
    if not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return [row for row in csv.DictReader(file) if int(row["step"]) <= last_step]


def _text(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"
