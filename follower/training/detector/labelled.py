"""One picture with what is to be found in it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from follower_vision.frame import Image

Floats = npt.NDArray[np.float32]
Numbers = npt.NDArray[np.intp]

IGNORED = -1
"""The class of what is neither to be found nor counted as a false alarm: too hidden, say."""


@dataclass(frozen=True, slots=True)
class LabelledImage:
    """A picture and the boxes in it.

    Attributes:
        image: (H, W, 3) uint8 BGR.
        boxes: (N, 4) left, top, right, bottom in pixels.
        classes: (N,) class numbers, or `IGNORED`.
        name: where it came from, for messages.
    """

    image: Image
    boxes: Floats
    classes: Numbers
    name: str = ""


class Pictures(Protocol):
    """Where a training's pictures come from."""

    @property
    def class_names(self) -> tuple[str, ...]:
        """The names of the classes, by their numbers."""
        ...

    def training(self, side: int, seed: int) -> Iterator[LabelledImage]:
        """Return an endless stream of square pictures of `side` pixels; one seed, one stream."""
        ...

    def held_out(self, side: int, count: int) -> list[LabelledImage]:
        """Return at most `count` pictures that no training sees, always the same."""
        ...


def no_boxes() -> tuple[Floats, Numbers]:
    """Return the boxes and classes of a picture with nothing to be found."""
    return np.empty((0, 4), np.float32), np.empty(0, np.intp)
