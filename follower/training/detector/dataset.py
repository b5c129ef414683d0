"""Folders of labelled pictures in YOLO's or COCO's form.

YOLO: `data.yaml` (or another YAML file with `names`), or `classes.txt` with a name a line, names
the classes. A text file for each picture stands beside it, or under `labels/` where the pictures
are under `images/`. Each line is `class centre-x centre-y width height`, as shares of the
picture's sides. COCO: JSON files, boxes in pixels.
"""

import json
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat

from follower.training.detector.labelled_image import (
    IGNORED,
    LabelledImage,
    distorted,
    read_picture,
)
from follower.training.detector.random_scene import shown, whole_view
from follower.training.detector.settings import FolderSettings
from follower_control.common.strict_config import SettingsError, parse, read_mapping

_YEARS = ("", "2014", "2017")
_LEARNT_WORDS = {f"train{year}" for year in _YEARS}
_HELD_OUT_WORDS = {f"{part}{year}" for part in ("val", "valid", "test") for year in _YEARS}
_ROUNDING = 2e-3
_LEAST_PICTURES = 2
_TEXT = "utf-8-sig"
"""UTF-8 with or without the byte order mark that Windows writes."""
_Corners = tuple[float, float, float, float]
_Length = Annotated[float, Field(gt=0, allow_inf_nan=False)]
PICTURE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".webp", ".tif", ".tiff"})


@dataclass(frozen=True, slots=True)
class Entry:
    """One picture's file and what is in it.

    Attributes:
        path: of the picture.
        boxes: left, top, right, bottom of each object.
        classes: class number of each object, or `IGNORED`.
        held_out: whether the names of files and folders keep it for validation.
        shares: whether the boxes are shares of the picture's sides, or pixels.
    """

    path: Path
    boxes: tuple[_Corners, ...]
    classes: tuple[int, ...]
    held_out: bool
    shares: bool = False

    def load(self) -> LabelledImage:
        """Read the picture.

        Raises:
            SettingsError: the file is no picture, or an object lies outside of it.
        """
        image = read_picture(self.path)
        height, width = image.shape[:2]
        boxes = np.array(self.boxes, np.float32).reshape(-1, 4)
        if self.shares:
            boxes = boxes * np.array([width, height, width, height], np.float32)
        if (boxes[:, :2] >= (width, height)).any() or (boxes[:, 2:] <= 0).any():
            raise SettingsError(f"{self.path}: a box lies outside the picture, {width}x{height}")
        return LabelledImage(image, boxes, np.array(self.classes, np.intp))


def is_held_out(path: Path) -> bool:
    """Return whether the first telling name, of a file's folders or its own, keeps it apart."""
    names = ({word.lower() for word in Path(part).stem.split("_")} for part in path.parts)
    telling = (words for words in names if words & (_LEARNT_WORDS | _HELD_OUT_WORDS))
    return bool(next(telling, set()) & _HELD_OUT_WORDS)


class _CocoImage(BaseModel):
    id: int
    file_name: str


class _CocoCategory(BaseModel):
    id: int
    name: str


class _CocoAnnotation(BaseModel):
    image_id: int
    category_id: int
    bbox: tuple[FiniteFloat, FiniteFloat, _Length, _Length]
    """Left, top, width and height in pixels."""
    iscrowd: bool = False


class _Coco(BaseModel):
    images: list[_CocoImage]
    annotations: list[_CocoAnnotation]
    categories: list[_CocoCategory]


def coco_files(folder: Path) -> list[Path]:
    """Return the JSON files of a folder, or of its `annotations`."""
    return _seen(folder, "*.json", "annotations/*.json")


def _seen(folder: Path, *patterns: str) -> list[Path]:
    """Return what fits a pattern, in order, but hidden files, as a Mac leaves beside each file."""
    found = (path for pattern in patterns for path in folder.glob(pattern))
    return sorted(path for path in found if not path.name.startswith("."))


def read_coco(folder: Path) -> tuple[tuple[str, ...], list[Entry]]:
    """Read the classes and all labels of a folder; pictures are read when they are needed.

    Raises:
        SettingsError: a file is broken, names a picture that is missing, or the files disagree
            about the categories.
    """
    names: tuple[str, ...] = ()
    entries: list[Entry] = []
    for path in coco_files(folder):
        coco = _parse_coco(path)
        categories = sorted(coco.categories, key=lambda category: category.id)
        own = tuple(category.name for category in categories)
        if names and own != names:
            raise SettingsError(f"{path}: its categories differ from those of the file before")
        names = own
        numbers = {category.id: number for number, category in enumerate(categories)}
        entries += _coco_entries(folder, path, coco, numbers)
    if not names or not entries:
        raise SettingsError(f"{folder}: there is no category or picture in its JSON files")
    return names, entries


def _parse_coco(path: Path) -> _Coco:
    try:
        data = json.loads(path.read_text(_TEXT))
    except json.JSONDecodeError as error:
        raise SettingsError(f"{path}, line {error.lineno}: no valid JSON: {error.msg}") from None
    except (OSError, UnicodeDecodeError):
        raise SettingsError(f"{path}: cannot be read") from None
    return parse(_Coco, data, f"{path}, COCO form")


def _coco_entries(folder: Path, path: Path, coco: _Coco, numbers: dict[int, int]) -> list[Entry]:
    objects: dict[int, list[tuple[int, _Corners]]] = defaultdict(list)
    for place, one in enumerate(coco.annotations):
        if one.category_id not in numbers:
            where = f"{path}, annotation {place}"
            raise SettingsError(f"{where}: there is no category {one.category_id!r}")
        x, y, width, height = one.bbox
        kind = IGNORED if one.iscrowd else numbers[one.category_id]
        objects[one.image_id].append((kind, (x, y, x + width, y + height)))
    entries, labels = [], path.relative_to(folder)
    for place, image in enumerate(coco.images):
        mine = objects.pop(image.id, [])
        picture = _picture(folder, path, image.file_name, f"{path}, image {place}")
        boxes, kinds = tuple(box for _, box in mine), tuple(kind for kind, _ in mine)
        held_out = is_held_out(Path(f"{labels}/{image.file_name}"))
        entries.append(Entry(picture, boxes, kinds, held_out))
    if objects:
        raise SettingsError(f"{path}: annotations name an image {next(iter(objects))!r}: no such")
    return entries


def _picture(folder: Path, path: Path, name: str, where: str) -> Path:
    """Return where a picture lies: beside the JSON file, or in one of the usual folders."""
    part = path.stem.split("_")[-1]
    for place in (path.parent, folder, folder / "images", folder / part, folder / "images" / part):
        if (place / name).is_file():
            return place / name
    raise SettingsError(f"{where}: the picture {name} is neither in {folder} nor in its `images`")


def read_yolo(folder: Path) -> tuple[tuple[str, ...], list[Entry]]:
    """Read the classes and all labels of a folder; pictures are read when they are needed.

    Raises:
        SettingsError: the names are missing, a line is wrong, or there are no pictures or labels.
    """
    names = _names(folder)
    pictures = [path for path in _seen(folder, "**/*") if path.suffix.lower() in PICTURE_SUFFIXES]
    if not pictures:
        raise SettingsError(f"{folder}: there are no pictures in it")
    entries = [_entry(folder, picture, len(names)) for picture in pictures]
    if not any(entry.classes for entry in entries):
        raise SettingsError(
            f"{folder}: no picture has a label: {_label_path(folder, pictures[0])} would be the "
            "first one's, with a line `class centre-x centre-y width height` for each object"
        )
    return names, entries


def _names(folder: Path) -> tuple[str, ...]:
    for path in _seen(folder, "*.yaml", "*.yml"):
        names = _yaml_names(path)
        if names:
            return names
    path = folder / "classes.txt"
    names = tuple(line.strip() for line in _lines(path) if line.strip())
    if names:
        return names
    raise SettingsError(
        f"{folder}: nothing names the classes: write data.yaml with `names: [my-drone]`"
    )


def _yaml_names(path: Path) -> tuple[str, ...]:
    names = read_mapping(path).get("names")
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


def _entry(folder: Path, picture: Path, classes: int) -> Entry:
    path = _label_path(folder, picture)
    objects = [
        _object(line.split(), f"{path}, line {number}", classes)
        for number, line in enumerate(_lines(path), start=1)
        if line.strip()
    ]
    boxes, kinds = tuple(box for _, box in objects), tuple(kind for kind, _ in objects)
    return Entry(picture, boxes, kinds, is_held_out(picture.relative_to(folder)), shares=True)


def _lines(path: Path) -> list[str]:
    """Return the lines of a file, none if it is not there."""
    try:
        return path.read_text(_TEXT).splitlines() if path.is_file() else []
    except UnicodeDecodeError:
        raise SettingsError(f"{path}: not a text file in UTF-8") from None


def _object(words: list[str], where: str, classes: int) -> tuple[int, _Corners]:
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


class FolderPictures:
    """Streams views of labelled pictures, and keeps a part of them from training.

    Args:
        folder: in YOLO's or COCO's form; COCO's has JSON files.
        settings: how it is used.
        seed: for parting the pictures, if the folder does not.

    Raises:
        SettingsError: the folder, a file in it or a line cannot be used.
    """

    def __init__(self, folder: Path, settings: FolderSettings, seed: int) -> None:
        if not folder.is_dir():
            raise SettingsError(f"{folder}: there is no such folder of pictures")
        self.class_names, entries = (read_coco if coco_files(folder) else read_yolo)(folder)
        self._views = settings.views_a_picture
        self._learnt = [entry for entry in entries if not entry.held_out]
        self._held_out = [entry for entry in entries if entry.held_out]
        if not self._learnt or not self._held_out:
            self._learnt, self._held_out = _parted(folder, entries, settings.held_out_share, seed)

    def training(self, side: int, seed: int) -> Iterator[LabelledImage]:
        """Return an endless stream of views; one seed, one stream.

        Raises:
            SettingsError: a picture cannot be read.
        """
        rng = np.random.default_rng([seed, 3])
        while True:
            for number in rng.permutation(len(self._learnt)).tolist():
                picture = self._learnt[number].load()
                for _ in range(self._views):
                    yield distorted(shown(picture, side, rng), rng)

    def held_out(self, side: int, count: int) -> list[LabelledImage]:
        """Return whole pictures that no training sees.

        Raises:
            SettingsError: a picture cannot be read.
        """
        return [whole_view(entry.load(), side) for entry in self._held_out[:count]]


def _parted(
    folder: Path, entries: list[Entry], share: float, seed: int
) -> tuple[list[Entry], list[Entry]]:
    if len(entries) < _LEAST_PICTURES:
        raise SettingsError(f"{folder}: one picture is too few: some are held out to measure with")
    order = np.random.default_rng([seed, 4]).permutation(len(entries)).tolist()
    count = min(len(entries) - 1, max(1, round(share * len(entries))))
    held_out = [entries[number] for number in sorted(order[:count])]
    return [entries[number] for number in sorted(order[count:])], held_out
