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
    "LO": "large occlusion",
    "LR": "low resolution",
    "LT": "long-term tracking",
    "MB": "motion blur",
    "OB": "object blur",
    "OCC": "occlusion",
    "OM": "object motion",
    "OPR": "out-of-plane rotation",
    "OV": "out of view",
    "POC": "partial occlusion",
    "ROT": "rotation",
    "SO": "small object",
    "SOB": "similar object",
    "SV": "scale variation",
    "VC": "viewpoint change",
}
_UAV123 = ("SV", "ARC", "LR", "FM", "FOC", "POC", "OV", "BC", "IV", "VC", "CM", "SOB")
_UAVDT = ("BC", "CM", "OM", "SO", "IV", "OB", "SV", "LT", "LO")
_VISDRONE = ("ARC", "BC", "CM", "FM", "FOC", "IV", "LR", "OV", "POC", "SOB", "SV", "VC")
_LASOT = (
    *("IV", "POC", "DEF", "MB", "CM", "ROT", "BC"),
    *("VC", "SV", "FOC", "FM", "OV", "LR", "ARC"),
)
_LASOT_ABSENT = {"full_occlusion.txt": "FOC", "out_of_view.txt": "OV"}
_GOT10K_LABELS = frozenset({"absence", "cover", "cut_by_image"})
_GOT10K_CLASSES = {"object_class": "object", "motion_class": "motion", "major_class": "kind"}
_WHOLLY_VISIBLE, _HALF_VISIBLE = 8, 3
"""GOT-10k's levels: 8 is all of the target, 3 is up to 45 %."""


def read_attributes(place: SequencePlace, frames: int) -> dict[str, Flags]:
    """Return the attributes that hold anywhere in a sequence, by name.

    Known are UAV123's `att/NAME.txt`, UAVDT's `att/NAME_att.txt`, VisDrone's
    `attributes/NAME_attr.txt`, LaSOT's `full_occlusion.txt`, `out_of_view.txt` and, from its
    toolkit, `att/NAME.txt` beside the categories, OTB's `attrs.txt`, VOT's `*.tag` and `*.label`,
    and GOT-10k's `cover.label`, `cut_by_image.label` and `meta_info.ini`.

    Raises:
        DatasetError: a file of attributes cannot be understood.
    """
    codes = (
        *_flagged_codes(place),
        *_lasot_codes(place.folder, frames),
        *_otb_codes(place.folder),
        *_got10k_classes(place.folder),
    )
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


def read_absence(folder: Path, frames: int) -> Flags:
    """Return the frames in which the target is said to be absent, whatever box they have.

    GOT-10k says so in `absence.label` and by 0 in `cover.label`, LaSOT in `full_occlusion.txt` and
    `out_of_view.txt`; their own toolkits do not score these frames either.

    Raises:
        DatasetError: such a file cannot be understood, or has another number of frames.
    """
    absent = [False] * frames
    for name in ("absence.label", "cover.label", *_LASOT_ABSENT):
        path = folder / name
        if path.is_file():
            levels = _levels(path)
            if len(levels) != frames:
                raise DatasetError(f"{path}: {len(levels)} numbers for {frames} boxes")
            unseen = [(level == 0) == (name == "cover.label") for level in levels]
            absent = [one or other for one, other in zip(absent, unseen, strict=True)]
    return tuple(absent)


def read_flags(path: Path, frames: int) -> Flags:
    """Read a number a line; a flag holds where it is not 0, and not beyond the file's end.

    Raises:
        DatasetError: the file cannot be read, holds something else, or is too long.
    """
    return tuple(value != 0 for value in _padded(path, frames))


def _padded(path: Path, frames: int) -> list[float]:
    levels = _levels(path)
    if len(levels) > frames:
        raise DatasetError(f"{path}: {len(levels)} numbers for {frames} boxes")
    return levels + [0.0] * (frames - len(levels))


def _levels(path: Path) -> list[float]:
    words = [word for line in read_lines(path) for word in re.split(r"[,\s]+", line) if word]
    try:
        return [float(word) for word in words]
    except ValueError:
        raise DatasetError(f"{path}: needs a number for each frame") from None


def _flagged_codes(place: SequencePlace) -> list[str]:
    """Return the attributes of a whole sequence that a file of flags names by their order."""
    truth, above = place.truth, place.folder.parent.parent
    files = {
        truth.parent / "att" / truth.name: _UAV123,
        truth.parent / "att" / f"{place.folder.name}_att.txt": _UAVDT,
        truth.parent.parent / "attributes" / f"{truth.stem}_attr.txt": _VISDRONE,
        above / "att" / f"{place.folder.name}.txt": _LASOT,
    }
    return [
        code
        for path, codes in files.items()
        if path.is_file()
        for code, holds in zip(codes, read_flags(path, len(codes)), strict=True)
        if holds
    ]


def _lasot_codes(folder: Path, frames: int) -> list[str]:
    """Return why LaSOT's target is absent anywhere; those frames themselves are not scored."""
    files = {folder / name: code for name, code in _LASOT_ABSENT.items()}
    return [
        code for path, code in files.items() if path.is_file() and any(read_flags(path, frames))
    ]


def _otb_codes(folder: Path) -> list[str]:
    path = folder / "attrs.txt"
    lines = read_lines(path) if path.is_file() else []
    return [code for line in lines for code in re.split(r"[,;\s]+", line) if code]


def _got10k_classes(folder: Path) -> list[str]:
    said = _pairs(folder / "meta_info.ini", ":")
    return [f"{name}: {said[key]}" for key, name in _GOT10K_CLASSES.items() if said.get(key)]


def _frame_tags(folder: Path, frames: int) -> dict[str, Flags]:
    paths = sorted([*folder.glob("[!.]*.tag"), *folder.glob("[!.]*.label")])
    own = [path for path in paths if path.stem not in _GOT10K_LABELS]
    return {path.stem.replace("_", " "): read_flags(path, frames) for path in own}


def _got10k_flags(folder: Path, frames: int) -> dict[str, Flags]:
    flags: dict[str, Flags] = {}
    cover, cut = folder / "cover.label", folder / "cut_by_image.label"
    if cover.is_file():
        levels = _padded(cover, frames)
        flags["partly covered"] = tuple(level < _WHOLLY_VISIBLE for level in levels)
        flags["mostly covered"] = tuple(level <= _HALF_VISIBLE for level in levels)
    if cut.is_file():
        flags["cut by image"] = read_flags(cut, frames)
    return flags


def _pairs(path: Path, between: str) -> Mapping[str, str]:
    lines = read_lines(path) if path.is_file() else []
    split = (line.partition(between) for line in lines)
    return {key.strip(): value.strip() for key, _, value in split}
