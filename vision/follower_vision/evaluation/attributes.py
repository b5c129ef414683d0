"""Reads what the field's data sets annotate: attributes of frames and sequences, frame rates."""

import re
from collections.abc import Mapping
from pathlib import Path

from follower_vision.evaluation.one_pass import DatasetError, SequencePlace, read_lines

Flags = tuple[bool, ...]
"""One a frame: whether the attribute holds there."""
_NAMES = {
    "ARC": "aspect ratio change",
    "BC": "background clutter",
    "CM": "camera motion",
    "DEF": "deformation",
    "FM": "fast motion",
    "FOC": "full occlusion",
    "IPR": "in-plane rotation",
    "IV": "illumination variation",
    "LR": "low resolution",
    "MB": "motion blur",
    "OCC": "occlusion",
    "OPR": "out-of-plane rotation",
    "OV": "out of view",
    "POC": "partial occlusion",
    "SOB": "similar object",
    "SV": "scale variation",
    "VC": "viewpoint change",
}
_UAV123 = ("SV", "ARC", "LR", "FM", "FOC", "POC", "OV", "BC", "IV", "VC", "CM", "SOB")
_GOT10K_LABELS = frozenset({"absence", "cover", "cut_by_image"})
_GOT10K_CLASSES = {"object_class": "object", "motion_class": "motion", "major_class": "kind"}
_WHOLLY_VISIBLE, _HALF_VISIBLE = 8, 3
"""GOT-10k's levels: 8 is all of the target, 3 is up to 45 %."""


def read_attributes(place: SequencePlace, frames: int) -> dict[str, Flags]:
    """Return the attributes that hold anywhere in a sequence, by name.

    Known are UAV123's `att/NAME.txt`, OTB's `attrs.txt`, VOT's `*.tag` and `*.label`, and
    GOT-10k's `cover.label`, `cut_by_image.label` and `meta_info.ini`.

    Raises:
        DatasetError: a file of attributes cannot be understood.
    """
    codes = (*_uav123_codes(place), *_otb_codes(place.folder), *_got10k_classes(place.folder))
    flags = {_NAMES.get(code, code): (True,) * frames for code in codes}
    flags |= _frame_tags(place.folder, frames) | _got10k_flags(place.folder, frames)
    return {name: values for name, values in flags.items() if any(values)}


def read_rate(place: SequencePlace) -> float | None:
    """Return the frames a second that the layout, VOT's or GOT-10k's own file states, if any."""
    said = _pairs(place.folder / "sequence", "=").get("fps")
    said = said or _pairs(place.folder / "meta_info.ini", ":").get("anno_fps")
    found = re.match(r"\d+(\.\d+)?", said or "")
    rate_hz = float(found.group()) if found else 0.0
    return rate_hz if rate_hz > 0 else place.rate_hz


def read_flags(path: Path, frames: int) -> Flags:
    """Read a number a line; a flag holds where it is not 0, and not beyond the file's end.

    Raises:
        DatasetError: the file cannot be read, holds something else, or is too long.
    """
    return tuple(value != 0 for value in _levels(path, frames))


def _levels(path: Path, frames: int) -> list[float]:
    words = [word for line in read_lines(path) for word in re.split(r"[,\s]+", line) if word]
    try:
        levels = [float(word) for word in words]
    except ValueError:
        raise DatasetError(f"{path}: needs a number for each frame") from None
    if len(levels) > frames:
        raise DatasetError(f"{path}: {len(levels)} numbers for {frames} boxes")
    return levels + [0.0] * (frames - len(levels))


def _uav123_codes(place: SequencePlace) -> list[str]:
    path = place.truth.parent / "att" / place.truth.name
    if not path.is_file():
        return []
    flags = read_flags(path, len(_UAV123))
    return [code for code, holds in zip(_UAV123, flags, strict=True) if holds]


def _otb_codes(folder: Path) -> list[str]:
    path = folder / "attrs.txt"
    lines = read_lines(path) if path.is_file() else []
    return [code for line in lines for code in re.split(r"[,;\s]+", line) if code]


def _got10k_classes(folder: Path) -> list[str]:
    said = _pairs(folder / "meta_info.ini", ":")
    return [f"{name}: {said[key]}" for key, name in _GOT10K_CLASSES.items() if said.get(key)]


def _frame_tags(folder: Path, frames: int) -> dict[str, Flags]:
    paths = sorted([*folder.glob("*.tag"), *folder.glob("*.label")])
    own = [path for path in paths if path.stem not in _GOT10K_LABELS]
    return {path.stem.replace("_", " "): read_flags(path, frames) for path in own}


def _got10k_flags(folder: Path, frames: int) -> dict[str, Flags]:
    flags: dict[str, Flags] = {}
    cover, cut = folder / "cover.label", folder / "cut_by_image.label"
    if cover.is_file():
        levels = _levels(cover, frames)
        flags["partly covered"] = tuple(level < _WHOLLY_VISIBLE for level in levels)
        flags["mostly covered"] = tuple(level <= _HALF_VISIBLE for level in levels)
    if cut.is_file():
        flags["cut by image"] = read_flags(cut, frames)
    return flags


def _pairs(path: Path, between: str) -> Mapping[str, str]:
    lines = read_lines(path) if path.is_file() else []
    split = (line.partition(between) for line in lines)
    return {key.strip(): value.strip() for key, _, value in split}
