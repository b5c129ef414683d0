"""How much each cell is of the eleven colours that languages name, and how bright.

In the spirit of van de Weijer, Schmid, Verbeek and Larlus, "Learning Color Names for Real-World
Applications" (2009), but with a closed form in the place of their learnt table: a soft vote by the
distance to each colour's prototype in CIE Lab.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.correlation.gradients import Channels
from follower_vision.frame import Image

_PROTOTYPES_RGB = (
    (0, 0, 0),
    (0, 0, 255),
    (110, 70, 40),
    (128, 128, 128),
    (0, 160, 0),
    (255, 140, 0),
    (255, 150, 190),
    (140, 0, 160),
    (230, 0, 0),
    (255, 255, 255),
    (255, 255, 0),
)
CHANNELS = len(_PROTOTYPES_RGB) + 1
_LAB_SIGMA = 25.0
_LEVELS = 32


def _lookup() -> npt.NDArray[np.float32]:
    """Votes and brightness, (32768, 12), by the upper five bits of blue, green and red; mean 0."""
    prototypes = np.array(_PROTOTYPES_RGB, np.float32)[None] / 255
    prototypes_lab = cv2.cvtColor(prototypes, cv2.COLOR_RGB2Lab)[0]
    level = (np.arange(_LEVELS, dtype=np.float32) + 0.5) / _LEVELS
    bgr = np.stack(np.meshgrid(level, level, level, indexing="ij"), axis=-1).reshape(1, -1, 3)
    lab = cv2.cvtColor(bgr, cv2.COLOR_BGR2Lab)[0]
    distance2 = ((lab[:, None] - prototypes_lab[None]) ** 2).sum(axis=-1)
    votes = np.exp(-distance2 / (2 * _LAB_SIGMA**2)) + 1e-9
    votes /= votes.sum(axis=1, keepdims=True)
    brightness = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY).reshape(-1, 1)
    table = np.concatenate([votes, brightness], axis=1)
    return np.asarray(table - table.mean(axis=0), np.float32)


_TABLE = _lookup()
_PLACE = np.array([_LEVELS * _LEVELS, _LEVELS, 1])


class ColourTable:
    """Turns pixels into colour channels, by default into all twelve.

    Args:
        directions: combinations of the channels to answer instead, shape (C, 12).
    """

    def __init__(self, directions: npt.NDArray[np.float32] | None = None) -> None:
        self._table = _TABLE if directions is None else _TABLE @ directions.T

    def __call__(self, patch: Image, cells: int) -> Channels:
        """Return (C, cells, cells) of a square patch."""
        pixels = np.asarray(
            cv2.resize(patch, (2 * cells, 2 * cells), interpolation=cv2.INTER_AREA), np.uint8
        )
        votes = np.take(self._table, (pixels >> 3) @ _PLACE, axis=0)
        averaged = cv2.resize(votes, (cells, cells), interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(averaged.reshape(cells, cells, -1).transpose(2, 0, 1))
