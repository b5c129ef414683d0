"""The feature channels of the translation filter, reduced to their principal components."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.correlation import colours
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
        self._bases: list[npt.NDArray[np.float32]] = []
        rim = np.hanning(self._cells + 2)[1:-1]
        self._window = np.outer(rim, rim).astype(np.float32)

    def start(self, patch: Image) -> None:
        """Choose the components from the first patch."""
        groups = self._groups(patch)
        self._bases = [
            _components(group * self._window, kept)
            for group, kept in zip(groups, self._kept, strict=True)
        ]

    def __call__(self, patch: Image) -> Channels:
        """Return (channels, cells, cells), weighted by a cosine window."""
        groups = self._groups(patch)
        reduced = [
            basis @ group.reshape(len(group), -1)
            for basis, group in zip(self._bases, groups, strict=True)
        ]
        channels = np.concatenate(reduced).reshape(-1, self._cells, self._cells)
        return np.asarray(channels * self._window, np.float32)

    def _groups(self, patch: Image) -> tuple[Channels, Channels]:
        grey = np.asarray(cv2.cvtColor(patch, cv2.COLOR_BGR2GRAY), np.uint8)
        colour = colours.colour_channels(patch, self._cells, self._cells)
        return self._gradients(grey), colour


def _components(channels: Channels, kept: int) -> npt.NDArray[np.float32]:
    """The `kept` strongest principal directions, shape (kept, C)."""
    samples = channels.reshape(len(channels), -1).astype(np.float64)
    _, directions = np.linalg.eigh(samples @ samples.T)
    return np.ascontiguousarray(directions[:, ::-1][:, :kept].T, np.float32)
