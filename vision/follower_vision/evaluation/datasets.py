"""Finds and loads sequences of the field's data sets, whose layouts are recognised by looking.

GOT-10k, OTB, UAV123, UAVDT, DTB70, VisDrone-SOT, LaSOT, TrackingNet, VOT, and our own. Boxes are
taken as the data set writes them; no origin is shifted.

UAV123, UAV20L and UAV123@10fps: Mueller, Smith and Ghanem, "A Benchmark and Simulator for UAV
Tracking" (ECCV 2016). The images lie in `data_seq/`, the boxes in `anno/`; several sequences are
cut out of one film.
"""

from collections import Counter
from pathlib import Path

from follower_vision.evaluation.attributes import read_absence, read_attributes, read_rate
from follower_vision.evaluation.one_pass import (
    DatasetError,
    Sequence,
    SequencePlace,
    has_rectangles,
    read_boxes,
    read_lines,
)
from follower_vision.geometry.box import Box
from follower_vision.sources.open import pictures_in

__all__ = ["DatasetError", "load_dataset", "read_boxes"]

PART_STARTS = {
    "bird1": (1, 775, 1573),
    "car1": (1, 751, 1627),
    "car6": (1, 487, 1807, 2953, 3925),
    "car8": (1, 1357),
    "car16": (1, 415),
    "group1": (1, 1333, 2515, 3925),
    "group2": (1, 907, 1771),
    "group3": (1, 1567, 2827, 4369),
    "person2": (1, 1189),
    "person4": (1, 1501),
    "person5": (1, 877),
    "person7": (1, 1249),
    "person8": (1, 1075),
    "person12": (1, 601),
    "person14": (1, 847, 1813),
    "person17": (1, 1501),
    "person19": (1, 1243, 2791),
    "truck4": (1, 577),
    "uav1": (1, 1555, 2473),
}
"""First frame of each part of a film (from the data set's configSeqs.m), at 30 frames a second."""

_KEPT_EVERY = 3
"""UAV123@10fps keeps every third frame: its frame 139 is frame 415 of the film."""
_TRUTHS = ("groundtruth_rect.txt", "groundtruth.txt")
_OTB_TARGETS = "groundtruth_rect.[0-9].txt"
_OTB_FIRST_FRAMES = {"david": 300}
_OTB_CUT = frozenset({*_OTB_FIRST_FRAMES, "football1", "freeman3", "freeman4", "diving"})
"""OTB's sequences with more images than boxes."""
_IMAGE_FOLDERS = ("img", "color", ".")
_PAIRED = (("sequences", "annotations"), ("frames", "anno"))
"""VisDrone-SOT's and TrackingNet's folders of images, and of files of boxes with their names."""
_UAVDT_ENDING = "_gt"
_DEPTH = 2
"""Folders between the one that is given and a sequence: LaSOT's categories, GOT-10k's parts."""


def is_uav123(folder: Path) -> bool:
    """Return whether a folder has UAV123's layout."""
    return (folder / "data_seq").is_dir() and (folder / "anno").is_dir()


def find_uav123(folder: Path) -> list[SequencePlace]:
    """Pair each file of boxes with the film that it belongs to; what has no images is left out."""
    films: dict[str, list[Path]] = {}
    for path in sorted(folder.glob("data_seq/**/*")):
        if path.is_dir():
            films.setdefault(path.name, []).append(path)
    truths = [path for path in sorted(folder.glob("anno/**/*.txt")) if path.parent.name != "att"]
    twice = {stem for stem, number in Counter(path.stem for path in truths).items() if number > 1}
    places = (_place(folder, truth, films, truth.stem in twice) for truth in truths)
    return [place for place in places if place is not None]


def _place(
    root: Path, truth: Path, films: dict[str, list[Path]], twice: bool
) -> SequencePlace | None:
    film, part = _film(truth.stem, films)
    if film not in films:
        return None
    subset = truth.parent.name
    folder = next((p for p in films[film] if p.parent.name == subset), films[film][0])
    slow = any(
        "10fps" in part.lower() for part in (root.resolve().name, subset, folder.parent.name)
    )
    start = PART_STARTS[film][part] if part else 1
    if slow:
        start = (start - 1) // _KEPT_EVERY + 1
    name = f"{subset}-{truth.stem}" if twice else truth.stem
    return SequencePlace(name, folder, truth, start, 10.0 if slow else 30.0, is_cut=True)


def _film(stem: str, films: dict[str, list[Path]]) -> tuple[str, int]:
    """Split car16_2 into its film and the number of its part from 0; others are a whole film."""
    film, _, number = stem.rpartition("_")
    parts = PART_STARTS.get(film, ())
    if stem in films or not (number.isdecimal() and 1 <= int(number) <= len(parts)):
        return stem, 0
    return film, int(number) - 1


def load_dataset(folder: Path) -> tuple[list[Sequence], list[str]]:
    """Load one sequence, a folder of sequences, or a data set in its own layout.

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
            f"{folder}: no sequence here; give a data set as it is unpacked, or a folder with "
            "groundtruth.txt or groundtruth_rect.txt beside its images, img/ or color/"
        )
    return sequences, remarks


def _find(folder: Path, depth: int = _DEPTH) -> list[SequencePlace]:
    if is_uav123(folder):
        return find_uav123(folder)
    places = _find_paired(folder) or _find_uavdt(folder) or _places(folder)
    if places or not depth:
        return places
    inside = sorted(path for path in folder.iterdir() if path.is_dir())
    return [place for path in inside for place in _find(path, depth - 1)]


def _find_paired(folder: Path) -> list[SequencePlace]:
    return [
        SequencePlace(truth.stem, folder / images / truth.stem, truth)
        for images, truths in _PAIRED
        for truth in sorted(folder.glob(f"{truths}/*.txt"))
        if (folder / images / truth.stem).is_dir()
    ]


def _find_uavdt(folder: Path) -> list[SequencePlace]:
    """Pair `UAV-benchmark-SOT_v1.0/anno/S0101_gt.txt` with `UAV-benchmark-S/S0101`."""
    pattern = f"anno/*{_UAVDT_ENDING}.txt"
    places = []
    for truth in sorted([*folder.glob(pattern), *folder.glob(f"*/{pattern}")]):
        name = truth.stem.removesuffix(_UAVDT_ENDING)
        images = next((p for p in (folder / name, *folder.glob(f"*/{name}")) if p.is_dir()), None)
        if images is not None:
            places.append(SequencePlace(name, images, truth, rate_hz=30.0))
    return places


def _places(folder: Path) -> list[SequencePlace]:
    """Return a folder's sequence; one a target where OTB has several in the same images."""
    name = folder.resolve().name
    first = _OTB_FIRST_FRAMES.get(name.lower(), 1)
    truth = next((folder / file for file in _TRUTHS if (folder / file).is_file()), None)
    is_cut = name.lower() in _OTB_CUT
    if truth is not None:
        return [SequencePlace(name, folder, truth, first, is_cut=is_cut)]
    targets = [path for path in sorted(folder.glob(_OTB_TARGETS)) if read_lines(path)]
    names = [f"{name}.{path.stem[-1]}" if len(targets) > 1 else name for path in targets]
    return [
        SequencePlace(name, folder, path, first, is_cut=is_cut)
        for name, path in zip(names, targets, strict=True)
    ]


def _load(place: SequencePlace) -> Sequence:
    truth = _truth(place)
    images = _images(place.folder)
    if len(images) > len(truth) and place.is_cut:
        images = images[place.first - 1 :][: len(truth)]
    if len(images) != len(truth):
        held_back = len(truth) == 1
        why = "more than the first box: it is held back" if held_back else "one line an image"
        raise DatasetError(
            f"{place.truth}: {len(truth)} boxes for {len(images)} images; needs {why}"
        )
    if len(truth) < 2 or truth[0] is None:
        raise DatasetError(f"{place.truth}: needs two frames or more and a box in the first")
    flags = read_attributes(place, len(truth))
    rectangles = has_rectangles(place.truth)
    return Sequence(place.name, tuple(images), tuple(truth), flags, read_rate(place), rectangles)


def _truth(place: SequencePlace) -> list[Box | None]:
    truth = read_boxes(place.truth)
    if len(truth) < 2:
        return truth
    absent = read_absence(place.folder, len(truth))
    return [None if gone else box for box, gone in zip(truth, absent, strict=True)]


def _images(folder: Path) -> list[Path]:
    for name in _IMAGE_FOLDERS:
        place = folder / name
        if place.is_dir():
            found = pictures_in(place)
            if found:
                return found
    raise DatasetError(f"{folder}: no images; put them there, into img/ or into color/")
