"""Which parts of the image the board has been in."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from follower.calibration.views import View

COLUMNS, ROWS = 8, 6
_ENOUGH = 3
_ACROSS, _DOWN = ("left", "middle", "right"), ("top", "middle", "bottom")


class Coverage:
    """How many corners were seen in each cell of the image.

    Args:
        views: of the board.
        size: the image's width and height.

    Attributes:
        counts: (ROWS, COLUMNS) corners.
    """

    def __init__(self, views: Iterable[View], size: tuple[int, int]) -> None:
        self.counts: npt.NDArray[np.int64] = np.zeros((ROWS, COLUMNS), np.int64)
        for view in views:
            cells = (view.seen.image_px / size * (COLUMNS, ROWS)).astype(int)
            columns = cells[:, 0].clip(0, COLUMNS - 1)
            rows = cells[:, 1].clip(0, ROWS - 1)
            np.add.at(self.counts, (rows, columns), 1)

    @property
    def covered(self) -> npt.NDArray[np.bool_]:
        """(ROWS, COLUMNS) whether there were corners enough."""
        return self.counts >= _ENOUGH

    @property
    def share(self) -> float:
        """Of the image's cells that are covered."""
        return float(self.covered.mean())

    def missing(self) -> list[str]:
        """Return the ninths of the image in which less than half is covered, in words."""
        names = []
        for down, rows in zip(_DOWN, np.array_split(self.covered, 3, axis=0), strict=True):
            for across, cells in zip(_ACROSS, np.array_split(rows, 3, axis=1), strict=True):
                if cells.mean() < 0.5:
                    names.append("middle" if down == across else f"{down} {across}")
        return names
