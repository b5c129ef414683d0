"""Finds and loads sequences of the field's data sets: OTB, UAV123, VOT, GOT-10k and our own.

Boxes are taken as the data set writes them; no origin is shifted.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from follower_vision.box import Box
from follower_vision.ope import Sequence

_IMAGES = frozenset({".jpg", ".jpeg", ".png", ".bmp"})
_TRUTHS = ("groundtruth_rect.txt", "groundtruth.txt")
_IMAGE_FOLDERS = ("img", "color", ".")


class DatasetError(ValueError):
    """A folder or file is no data set; the message is one line that says what to do."""


def load_dataset(folder: Path) -> tuple[list[Sequence], list[str]]:
    """Load one sequence, a folder of sequences, or UAV123 with `data_seq/` and `anno/`.

    Returns:
        The sequences in order of name, and a remark for each that was skipped as broken.

    Raises:
        DatasetError: the folder holds no sequence at all.
    """
    if not folder.is_dir():
        raise DatasetError(f"{folder}: there is no such folder; give a folder of sequences")
    sequences: list[Sequence] = []
    remarks: list[str] = []
    found = _find(folder)
    for name, pictures, truth in found:
        try:
            sequences.append(_load(name, pictures, truth))
        except DatasetError as error:
            remarks.append(f"skipped {name}: {error}")
    if not found:
        raise DatasetError(
            f"{folder}: no sequence here; one has groundtruth.txt or groundtruth_rect.txt beside "
            "its images, img/ or color/"
        )
    return sequences, remarks


def _find(folder: Path) -> list[tuple[str, Path, Path]]:
    if (folder / "data_seq").is_dir() and (folder / "anno").is_dir():
        return _find_uav123(folder)
    alone = _truth_file(folder)
    if alone is not None:
        return [(folder.resolve().name, folder, alone)]
    inside = [(path, _truth_file(path)) for path in sorted(folder.iterdir()) if path.is_dir()]
    return [(path.name, path, truth) for path, truth in inside if truth is not None]


def _find_uav123(folder: Path) -> list[tuple[str, Path, Path]]:
    """Pair the annotations with the image folders of the same name; parts of films have none."""
    pictures = {path.name: path for path in folder.glob("data_seq/**/*") if path.is_dir()}
    truths = sorted(folder.glob("anno/**/*.txt"))
    return [(t.stem, pictures[t.stem], t) for t in truths if t.stem in pictures]


def _truth_file(folder: Path) -> Path | None:
    return next((folder / name for name in _TRUTHS if (folder / name).is_file()), None)


def _load(name: str, folder: Path, truth_file: Path) -> Sequence:
    images = _images(folder)
    truth = [_box(truth_file, n, line) for n, line in enumerate(_lines(truth_file), 1)]
    absence = folder / "absence.label"
    if absence.is_file():
        flags = [line.strip() != "0" for line in _lines(absence)]
        if len(flags) != len(truth):
            raise DatasetError(f"{absence}: {len(flags)} lines for {len(truth)} boxes")
        truth = [None if absent else box for box, absent in zip(truth, flags, strict=True)]
    if len(images) != len(truth):
        raise DatasetError(
            f"{truth_file}: {len(truth)} boxes for {len(images)} images; give one line an image"
        )
    if len(truth) < 2 or truth[0] is None:
        raise DatasetError(f"{truth_file}: needs two frames or more and a box in the first")
    return Sequence(name, tuple(images), tuple(truth))


def _images(folder: Path) -> list[Path]:
    for name in _IMAGE_FOLDERS:
        place = folder / name
        if place.is_dir():
            found = sorted(path for path in place.iterdir() if path.suffix.lower() in _IMAGES)
            if found:
                return found
    raise DatasetError(f"{folder}: no images; put them there, into img/ or into color/")


def _lines(path: Path) -> list[str]:
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: cannot be read as text ({error})") from None
    return [line for line in text.splitlines() if line.strip()]


def _box(path: Path, number: int, line: str) -> Box | None:
    try:
        values = [float(word) for word in re.split(r"[,;\s]+", line.strip())]
    except ValueError:
        values = []
    if len(values) == 4:
        return _rectangle(values)
    if len(values) >= 6 and len(values) % 2 == 0:
        return _around(values)
    raise DatasetError(f"{path}:{number}: no box in {line.strip()[:60]!r}; write x,y,w,h")


def _rectangle(values: list[float]) -> Box | None:
    if not np.all(np.isfinite(values)) or min(values[2:]) <= 0:
        return None
    return Box.from_xywh(*values)


def _around(values: list[float]) -> Box | None:
    """Return the box around a polygon x1, y1, x2, y2, ..."""
    points = np.reshape(values, (-1, 2))
    low, high = points.min(axis=0), points.max(axis=0)
    return _rectangle([float(v) for v in (*low, *(high - low))])


def read_boxes(path: Path) -> list[Box | None]:
    """Read another program's result: a box x, y, w, h a line; absent ones are None.

    Raises:
        DatasetError: the file cannot be read, or a line holds no box.
    """
    return [_box(path, number, line) for number, line in enumerate(_lines(path), 1)]
