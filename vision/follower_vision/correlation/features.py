"""The feature channels of the translation filter, reduced to their principal components."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.correlation.colours import ColourTable
from follower_vision.correlation.gradients import Channels, GradientHistogram
from follower_vision.frame import Image


class Features:
    """Gradient and colour channels of a square patch, compressed and windowed.

    The compression (Danelljan, Khan, Felsberg and van de Weijer, CVPR 2014; here once, from the
    first patch) keeps the directions in which the target and its surroundings vary most.

    Args:
        patch_px: side of the patch in pixels.
        cell_px: side of a cell in pixels.
        gradient_channels: components kept of the gradient channels.
        colour_channels: components kept of the colour channels.
    """

    def __init__(
        self, patch_px: int, cell_px: int, gradient_channels: int, colour_channels: int
    ) -> None:
        self._cells = patch_px // cell_px
        self._gradients = GradientHistogram(patch_px, patch_px, cell_px)
        self._kept = (gradient_channels, colour_channels)
        self._directions = np.zeros((0, 0), np.float32)
        self._colours = ColourTable()
        rim = np.hanning(self._cells + 2)[1:-1]
        self._window = np.outer(rim, rim).astype(np.float32)

    def start(self, patch: Image) -> None:
        """Choose the components from the first patch."""
        gradient_channels, colour_channels = self._kept
        gradients = self._gradients(_grey(patch)) * self._window
        self._directions = _components(gradients, gradient_channels)
        colours = ColourTable()(patch, self._cells) * self._window
        self._colours = ColourTable(_components(colours, colour_channels))

    def __call__(self, patch: Image) -> Channels:
        """Return (channels, cells, cells), weighted by a cosine window."""
        gradients = self._gradients(_grey(patch))
        reduced = self._directions @ gradients.reshape(len(gradients), -1)
        gradients = reduced.reshape(-1, self._cells, self._cells)
        channels = np.concatenate([gradients, self._colours(patch, self._cells)])
        return np.asarray(channels * self._window, np.float32)


def _grey(patch: Image) -> npt.NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(patch, cv2.COLOR_BGR2GRAY), np.uint8)


def _components(channels: Channels, kept: int) -> npt.NDArray[np.float32]:
    """The `kept` strongest principal directions, shape (kept, C)."""
    samples = channels.reshape(len(channels), -1).astype(np.float64)
    _, directions = np.linalg.eigh(samples @ samples.T)
    return np.ascontiguousarray(directions[:, ::-1][:, :kept].T, np.float32)
