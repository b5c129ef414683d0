"""Reads a folder in YOLO's form: a text file beside each picture, a line for each object.

`data.yaml` (or another YAML file with `names`), or `classes.txt` with a name a line, tells the
classes. Labels stand beside the pictures, or under `labels/` where the pictures are under
`images/`. Each line is `class centre-x centre-y width height`, as shares of the picture's sides.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import yaml

from follower.training.detector.dataset import (
    PICTURE_SUFFIXES,
    Dataset,
    Entry,
    is_held_out,
    parted,
)
from follower_control.strict_yaml import SettingsError

_NAME_FILES = ("classes.txt", "obj.names", "names.txt")
_ROUNDING = 2e-3


def read_yolo(folder: Path) -> Dataset:
    """Read all labels of a folder; the pictures themselves are read when they are needed.

    Raises:
        SettingsError: the names are missing, a line is wrong, or there are no pictures or labels.
    """
    names = _names(folder)
    pictures = sorted(path for path in folder.rglob("*") if path.suffix.lower() in PICTURE_SUFFIXES)
    if not pictures:
        raise SettingsError(f"{folder}: there are no pictures in it")
    entries = [
        (_entry(folder, picture, names), is_held_out(picture.relative_to(folder)))
        for picture in pictures
    ]
    if not any(entry.classes for entry, _ in entries):
        raise SettingsError(
            f"{folder}: no picture has a label: {_label_path(folder, pictures[0])} would be the "
            "first one's, with a line `class centre-x centre-y width height` for each object"
        )
    return parted(names, entries)


def _names(folder: Path) -> tuple[str, ...]:
    for path in sorted([*folder.glob("*.yaml"), *folder.glob("*.yml")]):
        names = _yaml_names(path)
        if names:
            return names
    for path in (folder / name for name in _NAME_FILES):
        if path.is_file():
            lines = path.read_text(encoding="utf-8").splitlines()
            names = tuple(line.strip() for line in lines if line.strip())
            if names:
                return names
    raise SettingsError(
        f"{folder}: nothing names the classes: write data.yaml with `names: [my-drone]`"
    )


def _yaml_names(path: Path) -> tuple[str, ...]:
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError):
        raise SettingsError(f"{path}: no valid YAML") from None
    names = data.get("names") if isinstance(data, dict) else None
    if isinstance(names, dict):
        if sorted(names) != list(range(len(names))):
            raise SettingsError(f"{path}: names are numbered from 0 on without gaps")
        names = [names[number] for number in range(len(names))]
    if names is None:
        return ()
    if not isinstance(names, list) or not names:
        raise SettingsError(f"{path}: names is a list of the classes' names")
    return tuple(str(name) for name in names)


def _label_path(folder: Path, picture: Path) -> Path:
    parts = picture.relative_to(folder).parts
    if "images" in parts[:-1]:
        place = len(parts) - 2 - parts[-2::-1].index("images")
        parts = (*parts[:place], "labels", *parts[place + 1 :])
    return folder.joinpath(*parts).with_suffix(".txt")


def _entry(folder: Path, picture: Path, names: tuple[str, ...]) -> Entry:
    path = _label_path(folder, picture)
    objects = list(_objects(path, len(names))) if path.is_file() else []
    return Entry(
        picture, tuple(box for _, box in objects), tuple(kind for kind, _ in objects), shares=True
    )


def _objects(path: Path, classes: int) -> Iterator[tuple[int, tuple[float, float, float, float]]]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except UnicodeDecodeError:
        raise SettingsError(f"{path}: not a text file") from None
    for number, line in enumerate(lines, start=1):
        if line.strip():
            yield _object(line.split(), f"{path}, line {number}", classes)


def _object(
    words: list[str], where: str, classes: int
) -> tuple[int, tuple[float, float, float, float]]:
    try:
        kind, (x, y, width, height) = int(words[0]), (float(word) for word in words[1:])
    except ValueError:
        raise SettingsError(
            f"{where}: expected `class centre-x centre-y width height`, not {' '.join(words)!r}"
        ) from None
    if not 0 <= kind < classes:
        raise SettingsError(f"{where}: class {kind}, but there are {classes} names, from 0 on")
    box = (x - width / 2, y - height / 2, x + width / 2, y + height / 2)
    if not (width > 0 and height > 0):
        raise SettingsError(f"{where}: a box has a positive width and height")
    if not all(-_ROUNDING <= value <= 1 + _ROUNDING for value in box):
        raise SettingsError(
            f"{where}: the box reaches beyond the picture: the numbers are shares of its sides, "
            "from 0 to 1"
        )
    left, top, right, bottom = (min(1.0, max(0.0, value)) for value in box)
    return kind, (left, top, right, bottom)
