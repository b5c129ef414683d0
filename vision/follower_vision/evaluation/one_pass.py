"""Sequences for one-pass evaluation: images in order, and the true boxes from their text files."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image, load_image


class DatasetError(ValueError):
    """A folder or file is no data set; the message is one line that says what to do."""


@dataclass(frozen=True, slots=True)
class Sequence:
    """Images in order and the target's true box in each.

    Attributes:
        name: for tables.
        images: files, one a frame.
        truth: one a frame; None where the target is absent. The first is a box.
        attributes: by name, e.g. "occlusion", the frames in which each holds.
        rate_hz: frames a second, None if unknown.
        rectangles: the data set has boxes; else `truth` is the box around each region.
    """

    name: str
    images: tuple[Path, ...]
    truth: tuple[Box | None, ...]
    attributes: Mapping[str, tuple[bool, ...]] = field(default_factory=dict)
    rate_hz: float | None = None
    rectangles: bool = True

    @property
    def initial(self) -> Box:
        """The true box in the first frame."""
        first = self.truth[0]
        if first is None:
            raise ValueError(f"{self.name}: the first frame has no box")
        return first

    def frames(self) -> Iterator[Image]:
        """Read the images one after the other.

        Raises:
            OSError: one cannot be read.
        """
        for path in self.images:
            yield read_image(path)


@dataclass(frozen=True, slots=True)
class SequencePlace:
    """A sequence as it was found, not yet read.

    Attributes:
        name: for tables.
        folder: the images, or the folder above them.
        truth: the file of boxes.
        first: number of the image that the first box belongs to, from 1; used only where the
            folder has more images than the file has boxes.
        rate_hz: frames a second, None if the layout does not state it.
        is_cut: the folder may hold more images than the file has boxes.
    """

    name: str
    folder: Path
    truth: Path
    first: int = 1
    rate_hz: float | None = None
    is_cut: bool = False


def read_boxes(path: Path) -> list[Box | None]:
    """Read a region a line; None where the target is absent.

    A region is x, y, w, h; a polygon x1, y1, x2, y2, ...; or a mask as VOT writes it, "m" and the
    x, y, w, h of its bounds before its run lengths. Numbers stand apart by commas, semicolons,
    spaces or tabs. Not-a-number, a width or height of 0, and VOT's "0" mean an absent target.

    Raises:
        DatasetError: the file cannot be read, or a line holds no region.
    """
    return [_box(path, number, line) for number, line in enumerate(read_lines(path), 1)]


def has_rectangles(path: Path) -> bool:
    """Return whether each region in a file is x, y, w, h, or a target's absence.

    Raises:
        DatasetError: the file cannot be read.
    """
    return all(len(_numbers(line)) in (1, 4) for line in read_lines(path))


def read_lines(path: Path) -> list[str]:
    """Return the lines that hold something.

    Raises:
        DatasetError: the file cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{path}: cannot be read as text ({error})") from None
    return [line.strip() for line in text.splitlines() if line.strip()]


def _box(path: Path, number: int, line: str) -> Box | None:
    values = _numbers(line.removeprefix("m"))
    if line.startswith("m") and len(values) >= 4:
        return _rectangle(values[:4])
    if len(values) == 4:
        return _rectangle(values)
    if len(values) >= 6 and len(values) % 2 == 0:
        return _around(values)
    if values == [0.0]:
        return None
    raise DatasetError(f"{path}:{number}: no box in {line[:60]!r}; write x,y,w,h")


def _numbers(line: str) -> list[float]:
    try:
        return [float(word) for word in re.split(r"[,;\s]+", line) if word]
    except ValueError:
        return []


def _rectangle(values: list[float]) -> Box | None:
    try:
        return Box.from_xywh(*values)
    except ValueError:  # not finite, or without an area
        return None


def _around(values: list[float]) -> Box | None:
    points = np.reshape(values, (-1, 2))
    low, high = points.min(axis=0), points.max(axis=0)
    return _rectangle([float(v) for v in (*low, *(high - low))])


def read_image(path: Path) -> Image:
    """Read an image file as (H, W, 3) uint8 BGR.

    Raises:
        OSError: it cannot be read.
    """
    image = load_image(path)
    if image is None:
        raise OSError(f"cannot read the image {path}")
    return image


def start_box(box: Box, image: Image) -> Box:
    """Return the part of a true box, in pixels, from which a tracker can start.

    Raises:
        DatasetError: nothing of it lies inside the image, (H, W, 3).
    """
    height, width = image.shape[:2]
    inside = box.clipped(width, height)
    if inside is None:
        place = ",".join(f"{value:.0f}" for value in box.xywh)
        raise DatasetError(
            f"the box to start from, {place}, lies outside the {width}x{height} image"
        )
    return inside
