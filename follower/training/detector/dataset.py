"""Pictures of the user's own, as labelled on disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from follower.training.detector.labelled import LabelledImage
from follower_control.strict_yaml import SettingsError
from follower_vision.frame import Image

PICTURE_SUFFIXES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".webp", ".tif", ".tiff"})


@dataclass(frozen=True, slots=True)
class Entry:
    """One picture's file and what is in it.

    Attributes:
        path: of the picture.
        boxes: left, top, right, bottom of each object.
        classes: class number of each object, or `IGNORED`.
        shares: whether the boxes are shares of the picture's sides, or pixels.
    """

    path: Path
    boxes: tuple[tuple[float, float, float, float], ...]
    classes: tuple[int, ...]
    shares: bool = False

    def load(self) -> LabelledImage:
        """Read the picture.

        Raises:
            SettingsError: the file is no picture.
        """
        image = read_picture(self.path)
        height, width = image.shape[:2]
        boxes = np.array(self.boxes, np.float32).reshape(-1, 4)
        if self.shares:
            boxes = boxes * np.array([width, height, width, height], np.float32)
        classes = np.array(self.classes, np.intp)
        return LabelledImage(image, boxes, classes, str(self.path))


@dataclass(frozen=True, slots=True)
class Dataset:
    """All pictures of a folder.

    Attributes:
        names: of the classes, by their numbers.
        training: to learn from.
        held_out: to measure with; empty if the folder does not part them.
    """

    names: tuple[str, ...]
    training: tuple[Entry, ...]
    held_out: tuple[Entry, ...]


def read_picture(path: Path) -> Image:
    """Read a picture as (H, W, 3) uint8 BGR.

    Raises:
        SettingsError: the file is missing or is no picture.
    """
    try:
        content = np.frombuffer(path.read_bytes(), np.uint8)
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read: {error.strerror}") from None
    image = cv2.imdecode(content, cv2.IMREAD_COLOR) if len(content) else None
    if image is None:
        raise SettingsError(f"{path}: this is no picture, or it is broken")
    return np.asarray(image, np.uint8)


def is_held_out(path: Path) -> bool | None:
    """Tell from the names of a file and its folders for which part it is; None if they do not."""
    words = {word.lower() for part in path.parts for word in Path(part).stem.split("_")}
    for name, held_out in (("val", True), ("valid", True), ("test", True), ("train", False)):
        if any(word in (name, f"{name}2017", f"{name}2014") for word in words):
            return held_out
    return None


def parted(names: Sequence[str], entries: Sequence[tuple[Entry, bool | None]]) -> Dataset:
    """Part entries by what their names say; unless they name both parts, all are learnt from."""
    held_out = [entry for entry, apart in entries if apart]
    rest = [entry for entry, apart in entries if not apart]
    if not held_out or not rest:
        return Dataset(tuple(names), tuple(entry for entry, _ in entries), ())
    return Dataset(tuple(names), tuple(rest), tuple(held_out))
