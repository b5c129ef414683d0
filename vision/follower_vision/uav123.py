"""Finds the sequences of UAV123, UAV20L and UAV123@10fps.

Mueller, Smith and Ghanem, "A Benchmark and Simulator for UAV Tracking" (ECCV 2016). The images lie
in `data_seq/`, the boxes in `anno/`; several sequences are cut out of one film.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from follower_vision.sequenceplace import SequencePlace

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


def is_uav123(folder: Path) -> bool:
    """Tell whether a folder has UAV123's layout."""
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
    return SequencePlace(name, folder, truth, start, 10.0 if slow else 30.0)


def _film(stem: str, films: dict[str, list[Path]]) -> tuple[str, int]:
    """Split car16_2 into its film and the number of its part from 0; others are a whole film."""
    film, _, number = stem.rpartition("_")
    parts = PART_STARTS.get(film, ())
    if stem in films or not (number.isdecimal() and 1 <= int(number) <= len(parts)):
        return stem, 0
    return film, int(number) - 1
