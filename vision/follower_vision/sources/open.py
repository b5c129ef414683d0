"""Frames from a folder of numbered pictures."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np

from follower_vision.frame import Frame, Image
from follower_vision.framesource import ClosesItself, SourceError

SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp"})


class ImageFolder(ClosesItself):
    """Reads the pictures of a folder in natural order (2.jpg before 10.jpg) at a given rate.

    A folder without pictures but with a folder `img` in it, as most data sets have, stands for
    that one. A picture that cannot be decoded leaves a gap in the sequence numbers and a word in
    `problem`.

    Args:
        path: the folder.
        rate_hz: frames a second: picture i was taken at i / rate_hz seconds.

    Raises:
        SourceError: the folder is missing, unreadable or without pictures, or the rate is not
            positive.
    """

    def __init__(self, path: str | Path, rate_hz: float = 30.0) -> None:
        if not 0 < rate_hz < float("inf"):
            raise SourceError(f"{path}: a folder of images needs a positive rate, not {rate_hz:g}")
        self._rate_hz = rate_hz
        self._paths = _pictures(Path(path))
        self._next = 0
        self._broken: list[Path] = []

    @property
    def nominal_rate_hz(self) -> float:
        """The rate given."""
        return self._rate_hz

    @property
    def frame_count(self) -> int | None:
        """How many pictures there are."""
        return len(self._paths)

    @property
    def paths(self) -> list[Path]:
        """The pictures in order."""
        return list(self._paths)

    @property
    def problem(self) -> str | None:
        """Names the first picture that could not be decoded; None if there was none so far."""
        if not self._broken:
            return None
        return f"{self._broken[0]}: not a readable picture ({len(self._broken)} such were skipped)"

    def read(self) -> Frame | None:
        """Return the next picture that can be decoded, or None at the end."""
        while self._next < len(self._paths):
            index, self._next = self._next, self._next + 1
            image = _load(self._paths[index])
            if image is not None:
                return Frame(image, index / self._rate_hz, index)
            self._broken.append(self._paths[index])
        return None

    def close(self) -> None:
        """Forget the pictures that are left."""
        self._next = len(self._paths)


def natural_key(path: Path) -> tuple[tuple[int, int, str], ...]:
    """Return a sorting key by which numbers in a file's name count as numbers."""
    parts = re.split(r"(\d+)", path.name.lower())
    return tuple((0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts if part)


def _pictures(folder: Path) -> list[Path]:
    if not folder.exists():
        raise SourceError(f"{folder}: there is no such folder; check the path")
    found = _suitable(folder)
    if not found and (folder / "img").is_dir():
        found = _suitable(folder / "img")
    if not found:
        raise SourceError(
            f"{folder}: no pictures in this folder; it needs .jpg, .png or .bmp files"
        )
    if all(_load(path) is None for path in found[:3]):
        raise SourceError(f"{found[0]}: not a readable picture; are the files complete?")
    return found


def _suitable(folder: Path) -> list[Path]:
    try:
        entries = list(folder.iterdir())
    except OSError as error:
        raise SourceError(
            f"{folder}: cannot be read ({error.strerror}); give a folder with read permission"
        ) from error
    return sorted((p for p in entries if p.suffix.lower() in SUFFIXES), key=natural_key)


def _load(path: Path) -> Image | None:
    try:
        data = np.fromfile(path, np.uint8)
    except OSError:
        return None
    if not data.size:
        return None
    image = cv2.imdecode(data, cv2.IMREAD_COLOR)
    return None if image is None else np.asarray(image, np.uint8)
