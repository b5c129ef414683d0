"""Reads text files of data sets: a region a line, a box around each."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from follower_vision.box import Box


class DatasetError(ValueError):
    """A folder or file is no data set; the message is one line that says what to do."""


def read_boxes(path: Path) -> list[Box | None]:
    """Read a region a line; None where the target is absent.

    A region is x, y, w, h; a polygon x1, y1, x2, y2, ...; or a mask as VOT writes it, "m" and the
    x, y, w, h of its bounds before its run lengths. Numbers stand apart by commas, semicolons,
    spaces or tabs. Not-a-number, a width or height of 0, and VOT's "0" mean an absent target.

    Raises:
        DatasetError: the file cannot be read, or a line holds no region.
    """
    return [_box(path, number, line) for number, line in enumerate(read_lines(path), 1)]


def read_lines(path: Path) -> list[str]:
    """Return the lines that hold something.

    Raises:
        DatasetError: the file cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: cannot be read as text ({error})") from None
    return [line.strip() for line in text.splitlines() if line.strip()]


def _box(path: Path, number: int, line: str) -> Box | None:
    values = _numbers(line.removeprefix("m"))
    if line.startswith("m") and len(values) >= 4:
        return _rectangle(values[:4])
    if len(values) == 4:
        return _rectangle(values)
    if len(values) >= 6 and len(values) % 2 == 0:
        return _around(values)
    if values == [0.0]:
        return None
    raise DatasetError(f"{path}:{number}: no box in {line[:60]!r}; write x,y,w,h")


def _numbers(line: str) -> list[float]:
    try:
        return [float(word) for word in re.split(r"[,;\s]+", line)]
    except ValueError:
        return []


def _rectangle(values: list[float]) -> Box | None:
    if not np.all(np.isfinite(values)) or min(values[2:]) <= 0:
        return None
    return Box.from_xywh(*values)


def _around(values: list[float]) -> Box | None:
    points = np.reshape(values, (-1, 2))
    low, high = points.min(axis=0), points.max(axis=0)
    return _rectangle([float(v) for v in (*low, *(high - low))])
