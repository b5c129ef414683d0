"""Finds and loads sequences of the field's data sets: OTB, UAV123, VOT, GOT-10k and our own.

Boxes are taken as the data set writes them; no origin is shifted.
"""

from __future__ import annotations

from pathlib import Path

from follower_vision.attributes import read_attributes, read_flags, read_rate
from follower_vision.box import Box
from follower_vision.ope import Sequence
from follower_vision.sequenceplace import SequencePlace
from follower_vision.truthfile import DatasetError, read_boxes, read_lines
from follower_vision.uav123 import find_uav123, is_uav123

__all__ = ["DatasetError", "load_dataset", "read_boxes"]

_IMAGES = frozenset({".jpg", ".jpeg", ".png", ".bmp"})
_TRUTHS = ("groundtruth_rect.txt", "groundtruth.txt")
_OTB_TARGETS = "groundtruth_rect.[0-9].txt"
_OTB_FIRST_FRAMES = {"david": 300}
_OTB_CUT = frozenset({*_OTB_FIRST_FRAMES, "football1", "freeman3", "freeman4", "diving"})
"""OTB's sequences with more images than boxes."""

_IMAGE_FOLDERS = ("img", "color", ".")


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
    places = _find(folder)
    for place in places:
        try:
            sequences.append(_load(place))
        except DatasetError as error:
            remarks.append(f"skipped {place.name}: {error}")
    if not places:
        raise DatasetError(
            f"{folder}: no sequence here; one has groundtruth.txt or groundtruth_rect.txt beside "
            "its images, img/ or color/"
        )
    return sequences, remarks


def _find(folder: Path) -> list[SequencePlace]:
    if is_uav123(folder):
        return find_uav123(folder)
    alone = _places(folder)
    if alone:
        return alone
    inside = sorted(path for path in folder.iterdir() if path.is_dir())
    return [place for path in inside for place in _places(path)]


def _places(folder: Path) -> list[SequencePlace]:
    """Return a folder's sequence; one a target where OTB has several in the same images."""
    name = folder.resolve().name
    first = _OTB_FIRST_FRAMES.get(name.lower(), 1)
    truth = next((folder / file for file in _TRUTHS if (folder / file).is_file()), None)
    if truth is not None:
        return [SequencePlace(name, folder, truth, first)]
    targets = [path for path in sorted(folder.glob(_OTB_TARGETS)) if read_lines(path)]
    return [
        SequencePlace(f"{name}.{path.stem[-1]}" if len(targets) > 1 else name, folder, path, first)
        for path in targets
    ]


def _load(place: SequencePlace) -> Sequence:
    truth = _truth(place)
    images = _images(place.folder)
    if len(images) > len(truth) and _is_cut(place):
        images = images[place.first - 1 :][: len(truth)]
    if len(images) != len(truth):
        raise DatasetError(
            f"{place.truth}: {len(truth)} boxes for {len(images)} images; give one line an image"
        )
    if len(truth) < 2 or truth[0] is None:
        raise DatasetError(f"{place.truth}: needs two frames or more and a box in the first")
    flags = read_attributes(place, len(truth))
    return Sequence(place.name, tuple(images), tuple(truth), flags, read_rate(place))


def _truth(place: SequencePlace) -> list[Box | None]:
    truth = read_boxes(place.truth)
    absence = place.folder / "absence.label"
    if not absence.is_file():
        return truth
    number = len(read_lines(absence))
    if number != len(truth):
        raise DatasetError(f"{absence}: {number} lines for {len(truth)} boxes")
    flags = read_flags(absence, len(truth))
    return [None if absent else box for box, absent in zip(truth, flags, strict=True)]


def _is_cut(place: SequencePlace) -> bool:
    """Tell whether the data set uses a part of its images: UAV123's films, some of OTB."""
    return place.truth.parent != place.folder or place.name.lower() in _OTB_CUT


def _images(folder: Path) -> list[Path]:
    for name in _IMAGE_FOLDERS:
        place = folder / name
        if place.is_dir():
            found = sorted(path for path in place.iterdir() if path.suffix.lower() in _IMAGES)
            if found:
                return found
    raise DatasetError(f"{folder}: no images; put them there, into img/ or into color/")
