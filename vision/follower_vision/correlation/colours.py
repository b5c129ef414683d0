"""How much each cell is of the eleven colours that languages name.

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
    """Votes, (32768, 11), over the upper five bits of blue, green and red; each colour mean 0."""
    prototypes = np.array(_PROTOTYPES_RGB, np.float32)[None] / 255
    prototypes_lab = cv2.cvtColor(prototypes, cv2.COLOR_RGB2Lab)[0]
    level = (np.arange(_LEVELS, dtype=np.float32) + 0.5) / _LEVELS
    bgr = np.stack(np.meshgrid(level, level, level, indexing="ij"), axis=-1).reshape(1, -1, 3)
    lab = cv2.cvtColor(bgr, cv2.COLOR_BGR2Lab)[0]
    distance2 = ((lab[:, None] - prototypes_lab[None]) ** 2).sum(axis=-1)
    votes = np.exp(-distance2 / (2 * _LAB_SIGMA**2)) + 1e-9
    votes /= votes.sum(axis=1, keepdims=True)
    return np.asarray(votes - votes.mean(axis=0), np.float32)


_VOTES = _lookup()
_PLACE = np.array([_LEVELS * _LEVELS, _LEVELS, 1])


def colour_channels(patch: Image, rows: int, columns: int) -> Channels:
    """Return (12, rows, columns): eleven colour votes and the brightness, about mean 0."""
    pixels = np.asarray(
        cv2.resize(patch, (2 * columns, 2 * rows), interpolation=cv2.INTER_AREA), np.uint8
    )
    votes = _VOTES[(pixels >> 3) @ _PLACE]
    cells = votes.reshape(rows, 2, columns, 2, -1).mean(axis=(1, 3))
    grey = cv2.cvtColor(
        cv2.resize(pixels, (columns, rows), interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY
    )
    brightness = grey.astype(np.float32) / 255 - np.float32(0.5)
    return np.concatenate([cells.transpose(2, 0, 1), brightness[None]])
