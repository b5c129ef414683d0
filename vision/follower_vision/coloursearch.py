"""Looks for the target's colours in a whole image."""

from __future__ import annotations

import math
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.appearance import colour_histogram, histogram_bins
from follower_vision.box import Box
from follower_vision.crop import crop
from follower_vision.frame import Image
from follower_vision.reduce import halved

_LEAST_SIDE = 7.0
_MOST_PIXELS = 320 * 240
_MOST_PIXELS_SMALL_TARGET = 640 * 480
_PEAKS = 3
_LEAST_SHARE_OF_OWN = 0.45
_LEAST_CONTRAST = 3.0
_FILL = (127.0, 127.0, 127.0)
_SIDE = 24


class ColourSearch:
    """Back-projects the colours that the target has and its surroundings have not.

    A target whose colours are those of the background cannot be found this way: `distinctive`
    is then false and there are no candidates.
    """

    def __init__(self) -> None:
        self._weights: npt.NDArray[np.float32] | None = None
        self._box = Box(0, 0, 1, 1)
        self._own = 0.0

    @property
    def distinctive(self) -> bool:
        """Whether the target's colours stand out in the image that it was learnt from."""
        return self._weights is not None

    def learn(self, image: Image, box: Box) -> None:
        """Take the target's colours and the image's, (H, W, 3) uint8 BGR."""
        self._box = box
        target = colour_histogram(crop(image, box, _SIDE, _SIDE, _FILL))
        halvings = _halvings(image, box)
        factor = 0.5**halvings
        cells = _cells(_reduced(image, halvings))
        colours = _cell_bins().take(cells)
        around = np.bincount(colours.ravel(), minlength=len(target)) / colours.size
        likely = target / (target + around + 0.02)
        weights = likely.astype(np.float32).take(_cell_bins())
        density = self._density(cells, weights, factor)
        self._own = _at(density, box, factor)
        contrast = self._own / max(1e-6, float(density.mean()))
        self._weights = weights if contrast > _LEAST_CONTRAST and self._own > 0.1 else None

    def candidates(self, image: Image) -> list[Box]:
        """Return the places that have most of the colours, the best first, at the last size."""
        if self._weights is None:
            return []
        halvings = _halvings(image, self._box)
        factor = 0.5**halvings
        density = self._density(_cells(_reduced(image, halvings)), self._weights, factor)
        wide = max(1, round(self._box.width * factor))
        tall = max(1, round(self._box.height * factor))
        found = []
        for _ in range(_PEAKS):
            _, value, _, (x, y) = cv2.minMaxLoc(density)
            if value < _LEAST_SHARE_OF_OWN * self._own:
                break
            found.append(self._box.moved_to((x + 0.5) / factor, (y + 0.5) / factor))
            density[max(0, y - tall) : y + tall + 1, max(0, x - wide) : x + wide + 1] = 0
        return found

    def _density(
        self, cells: npt.NDArray[np.uint16], weights: npt.NDArray[np.float32], factor: float
    ) -> npt.NDArray[np.float32]:
        """Mean weight in a box of the target's size about every pixel of the reduced image."""
        likely = weights.take(cells)
        kernel = (
            max(1, round(self._box.width * factor)),
            max(1, round(self._box.height * factor)),
        )
        blurred = cv2.blur(likely, kernel, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(blurred, np.float32)


def _halvings(image: Image, box: Box) -> int:
    """How often to halve: to few pixels, but a target keeps its least side as far as possible."""
    pixels = image.shape[0] * image.shape[1]
    few = math.sqrt(_MOST_PIXELS / pixels)
    enough = _LEAST_SIDE / min(box.width, box.height)
    bearable = math.sqrt(_MOST_PIXELS_SMALL_TARGET / pixels)
    return max(0, round(-math.log2(max(few, min(enough, bearable)))))


def _reduced(image: Image, halvings: int) -> Image:
    for _ in range(halvings):
        image = halved(image)
    return image


def _cells(image: Image) -> npt.NDArray[np.uint16]:
    """Number of each pixel's cell among 32 x 32 x 32 colours, (H, W)."""
    coarse = (image >> 3).astype(np.uint16)
    return np.asarray(coarse[..., 0] << 10 | coarse[..., 1] << 5 | coarse[..., 2])


@cache
def _cell_bins() -> npt.NDArray[np.intp]:
    """The colour histogram's bin of each of the 32768 cells."""
    cells = np.arange(1 << 15)
    colours = np.stack([cells >> 10, cells >> 5 & 31, cells & 31], axis=-1) * 8 + 4
    hsv = cv2.cvtColor(colours[None].astype(np.uint8), cv2.COLOR_BGR2HSV)
    return np.asarray(histogram_bins(np.asarray(hsv, np.uint8))[0])


def _at(density: npt.NDArray[np.float32], box: Box, factor: float) -> float:
    row = min(density.shape[0] - 1, max(0, int(box.cy * factor)))
    column = min(density.shape[1] - 1, max(0, int(box.cx * factor)))
    return float(density[row, column])
