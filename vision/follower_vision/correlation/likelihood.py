"""Where the colours are the target's rather than its surroundings'.

After Bertinetto, Valmadre, Golodetz, Miksik and Torr, "Staple: Complementary Learners for Real-Time
Tracking" (CVPR 2016): histograms do not know where in the target a colour is, so they hold on to
one that turns or bends, where a correlation filter, which knows nothing else, lets go.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.frame import Image

_LEVELS = 16
_SHIFT = 4
_PLACE = np.array([_LEVELS * _LEVELS, _LEVELS, 1])
_INNER_SHARE = 0.8
_EMPTY = 1e-5
_USELESS_GAP = 0.2
_USEFUL_GAP = 0.4

Histogram = npt.NDArray[np.float64]
Colours = npt.NDArray[np.intp]
"""The place of each pixel's colour in the histograms, (2 cells, 2 cells)."""


class ColourLikelihood:
    """Histograms of the target's and its surroundings' colours.

    Args:
        cells: side of the search region in cells.
        target_columns: the target's width in cells.
        target_rows: the target's height in cells.
    """

    def __init__(self, cells: int, target_columns: float, target_rows: float) -> None:
        self._cells = cells
        self._pixels = 2 * cells
        self._width, self._height = 2 * target_columns, 2 * target_rows
        self._target: Histogram = np.zeros(_LEVELS**3)
        self._around: Histogram = np.zeros(_LEVELS**3)

    def look(self, patch: Image) -> Colours:
        """Return the colours of a patch: the search region, square."""
        size = (self._pixels, self._pixels)
        pixels = np.asarray(cv2.resize(patch, size, interpolation=cv2.INTER_AREA), np.uint8)
        return np.asarray((pixels >> _SHIFT) @ _PLACE, np.intp)

    def learn(self, seen: Colours, across: float, down: float, rate: float) -> None:
        """Blend a patch's colours into the histograms.

        Args:
            seen: the patch, as `look` returned it.
            across: the target's place to the right of the patch's middle, in cells.
            down: its place below the middle, in cells.
            rate: share of this patch in the histograms, 1 for the first.
        """
        inside, around = self._regions(2 * across, 2 * down)
        self._target += rate * (_histogram(seen[inside]) - self._target)
        self._around += rate * (_histogram(seen[around]) - self._around)

    def usefulness(self) -> float:
        """Return how well colour tells the target from its surroundings, 0 (not at all) to 1.

        By the mean likelihood on the target less the mean around it, which is 0 for equal colours
        and 1 for colours without one in common; grey images and camouflage stay about 0.3.
        """
        gap = float((self._target - self._around) @ self._table())
        return min(1.0, max(0.0, (gap - _USELESS_GAP) / (_USEFUL_GAP - _USELESS_GAP)))

    def response(self, seen: Colours) -> npt.NDArray[np.float32]:
        """Return (cells, cells): the mean likelihood, 0 to 1, in the box at each shift from [0, 0].

        The shifts are cyclic, as those of a correlation filter's response.
        """
        likelihood = np.take(self._table().astype(np.float32), seen)
        size = (_odd(self._width), _odd(self._height))
        in_box = cv2.blur(likelihood, size, borderType=cv2.BORDER_REPLICATE)
        by_cell = cv2.resize(in_box, (self._cells, self._cells), interpolation=cv2.INTER_AREA)
        # The patch's middle is the corner of four cells.
        rows = by_cell + np.roll(by_cell, 1, axis=0)
        corners = (rows + np.roll(rows, 1, axis=1)) / 4
        return np.asarray(np.fft.ifftshift(corners), np.float32)

    def _table(self) -> Histogram:
        """The likelihood of each colour."""
        return self._target / (self._target + self._around + _EMPTY)

    def _regions(
        self, across: float, down: float
    ) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """The target's inner part, and a frame about it as wide as the target."""
        place = np.arange(self._pixels) + 0.5 - self._pixels / 2
        column, row = np.abs(place - across), np.abs(place - down)
        width, height = self._width / 2, self._height / 2
        margin = width + height
        inner = np.outer(
            row < max(1.0, height * _INNER_SHARE), column < max(1.0, width * _INNER_SHARE)
        )
        target = np.outer(row < height, column < width)
        near = np.outer(row < height + margin, column < width + margin)
        return inner, near & ~target


def _histogram(colours: Colours) -> Histogram:
    return np.bincount(colours, minlength=_LEVELS**3) / max(1, len(colours))


def _odd(size: float) -> int:
    """The nearest odd number, so that a window has a middle."""
    return 2 * max(0, round((size - 1) / 2)) + 1
