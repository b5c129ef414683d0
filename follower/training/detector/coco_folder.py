"""Reads a folder in COCO's form: JSON files with images, annotations and categories."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from pathlib import Path
from typing import Any

from follower.training.detector.dataset import Dataset, Entry, is_held_out, parted
from follower.training.detector.labelled import IGNORED
from follower_control.strict_yaml import SettingsError

_PARTS = ("images", "annotations", "categories")
_Corners = tuple[float, float, float, float]


def coco_files(folder: Path) -> list[Path]:
    """Return the JSON files of a folder, or of its `annotations`."""
    return sorted([*folder.glob("*.json"), *folder.glob("annotations/*.json")])


def read_coco(folder: Path) -> Dataset:
    """Read all labels of a folder; the pictures themselves are read when they are needed.

    Raises:
        SettingsError: a file is broken, names a picture that is missing, or the files disagree
            about the categories.
    """
    names: tuple[str, ...] | None = None
    entries: list[tuple[Entry, bool | None]] = []
    for path in coco_files(folder):
        data = _data(path)
        numbers, own = _categories(path, data["categories"])
        if names is not None and own != names:
            raise SettingsError(f"{path}: its categories differ from those of the file before")
        names = own
        apart = is_held_out(path.relative_to(folder))
        entries += [(entry, apart) for entry in _entries(folder, path, data, numbers)]
    if names is None or not entries:
        raise SettingsError(f"{folder}: there is no picture in its JSON files")
    return parted(names, entries)


def _data(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise SettingsError(f"{path}, line {error.lineno}: no valid JSON: {error.msg}") from None
    except (OSError, UnicodeDecodeError):
        raise SettingsError(f"{path}: cannot be read") from None
    for part in _PARTS:
        if not isinstance(data, dict) or not isinstance(data.get(part), list):
            raise SettingsError(f"{path}: not in COCO's form: it has no list {part!r}")
    return dict(data)


def _categories(path: Path, categories: list[Any]) -> tuple[dict[Any, int], tuple[str, ...]]:
    """Return the class number of each category's id, and the names."""
    try:
        known = sorted((one["id"], str(one["name"])) for one in categories)
    except (KeyError, TypeError):
        raise SettingsError(f"{path}: each category has an `id` and a `name`") from None
    if not known:
        raise SettingsError(f"{path}: there is no category")
    return {key: number for number, (key, _) in enumerate(known)}, tuple(n for _, n in known)


def _entries(
    folder: Path, path: Path, data: dict[str, Any], numbers: dict[Any, int]
) -> list[Entry]:
    objects: dict[Any, list[tuple[int, _Corners]]] = defaultdict(list)
    for place, annotation in enumerate(data["annotations"]):
        where = f"{path}, annotation {place}"
        image, kind, corners = _object(annotation, where, numbers)
        objects[image].append((kind, corners))
    entries = []
    for place, image in enumerate(data["images"]):
        where = f"{path}, image {place}"
        if not isinstance(image, dict) or "id" not in image or "file_name" not in image:
            raise SettingsError(f"{where}: an image has an `id` and a `file_name`")
        mine = objects.pop(image["id"], [])
        picture = _picture(folder, path, str(image["file_name"]), where)
        entries.append(Entry(picture, tuple(c for _, c in mine), tuple(k for k, _ in mine)))
    if objects:
        raise SettingsError(f"{path}: annotations name an image {next(iter(objects))!r}: no such")
    return entries


def _object(annotation: Any, where: str, numbers: dict[Any, int]) -> tuple[Any, int, _Corners]:
    """Return image, class number and corners of an annotation."""
    try:
        image, category = annotation["image_id"], annotation["category_id"]
        x, y, width, height = (float(value) for value in annotation["bbox"])
    except (KeyError, TypeError, ValueError):
        raise SettingsError(
            f"{where}: expected `image_id`, `category_id` and `bbox` [left, top, width, height]"
        ) from None
    if category not in numbers:
        raise SettingsError(f"{where}: there is no category {category!r}")
    if not (width > 0 and height > 0 and all(map(math.isfinite, (x, y, width, height)))):
        raise SettingsError(f"{where}: a box has a positive width and height, in pixels")
    kind = IGNORED if annotation.get("iscrowd") else numbers[category]
    return image, kind, (x, y, x + width, y + height)


def _picture(folder: Path, path: Path, name: str, where: str) -> Path:
    """Return where a picture lies: beside the JSON file, or in one of the usual folders."""
    part = path.stem.split("_")[-1]
    for place in (path.parent, folder, folder / "images", folder / part, folder / "images" / part):
        if (place / name).is_file():
            return place / name
    raise SettingsError(f"{where}: the picture {name} is neither in {folder} nor in its `images`")
