"""Pictures from a folder of the user's own, in YOLO's or COCO's form."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from follower.training.detector.coco_folder import coco_files, read_coco
from follower.training.detector.dataset import Entry
from follower.training.detector.distort import distorted
from follower.training.detector.folder_settings import FolderSettings
from follower.training.detector.labelled import LabelledImage
from follower.training.detector.views import shown, whole_view
from follower.training.detector.yolo_folder import read_yolo
from follower_control.strict_yaml import SettingsError

_LEAST_PICTURES = 2


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
        dataset = read_coco(folder) if coco_files(folder) else read_yolo(folder)
        self.class_names = dataset.names
        self._views = settings.views_a_picture
        learnt, held_out = list(dataset.training), list(dataset.held_out)
        if not held_out:
            learnt, held_out = _parted(folder, learnt, settings.held_out_share, seed)
        self._learnt, self._held_out = learnt, held_out

    @property
    def counts(self) -> tuple[int, int]:
        """How many pictures are learnt from, and how many are held out."""
        return len(self._learnt), len(self._held_out)

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
