"""Histograms of oriented gradients in cells.

After Felzenszwalb, Girshick, McAllester and Ramanan, "Object Detection with Discriminatively
Trained Part-Based Models" (PAMI 2010): 18 signed and 9 unsigned orientations, each normalised by
its four neighbourhoods and clipped, and the energies of those neighbourhoods.
"""

from __future__ import annotations

from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

Channels: TypeAlias = npt.NDArray[np.float32]
"""Feature channels, shape (C, rows, columns)."""

ORIENTATIONS = 18
CHANNELS = ORIENTATIONS + ORIENTATIONS // 2 + 4
_CLIP = 0.2
_TEXTURE_GAIN = 0.2357
_DIFFERENCES = 511


def _lookup() -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float32]]:
    """Tables of orientation bin and magnitude over all pairs of 8-bit differences."""
    steps = np.arange(-255, 256)
    across, down = np.meshgrid(steps, steps, indexing="ij")
    turn = np.arctan2(down, across) / (2 * np.pi) * ORIENTATIONS
    bins = np.floor(turn + 0.5).astype(np.intp) % ORIENTATIONS
    magnitude = np.hypot(across, down) / 255
    return bins.ravel(), magnitude.ravel().astype(np.float32)


_BINS, _MAGNITUDE = _lookup()


class GradientHistogram:
    """Turns grey images of one size into cells of gradient histograms.

    Args:
        height: image height in pixels, a multiple of `cell_px`.
        width: image width in pixels, a multiple of `cell_px`.
        cell_px: side of a cell in pixels.
    """

    def __init__(self, height: int, width: int, cell_px: int) -> None:
        self._rows, self._columns = height // cell_px + 2, width // cell_px + 2
        row, row_weight = _neighbours(height, cell_px)
        column, column_weight = _neighbours(width, cell_px)
        cells = row[:, None, :, None] * self._columns + column[None, :, None, :]
        self._cells = cells.reshape(4, -1)
        weights = row_weight[:, None, :, None] * column_weight[None, :, None, :]
        self._weights = weights.reshape(4, -1).astype(np.float32)

    def __call__(self, grey: npt.NDArray[np.uint8]) -> Channels:
        """Return (31, rows, columns) of a (height, width) image."""
        return _normalised(self._histogram(grey))

    def _histogram(self, grey: npt.NDArray[np.uint8]) -> Channels:
        across = cv2.Sobel(grey, cv2.CV_16S, 1, 0, ksize=1)
        down = cv2.Sobel(grey, cv2.CV_16S, 0, 1, ksize=1)
        place = (across.astype(np.int32) + 255) * _DIFFERENCES + (down + 255)
        pair = np.asarray(place, np.intp).ravel()
        count = self._rows * self._columns
        places = self._cells + np.take(_BINS, pair) * count
        votes = self._weights * np.take(_MAGNITUDE, pair)
        summed = np.bincount(places.ravel(), votes.ravel(), ORIENTATIONS * count)
        cells = summed.reshape(ORIENTATIONS, self._rows, self._columns)
        return cells[:, 1:-1, 1:-1].astype(np.float32)


def _neighbours(size: int, cell_px: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float64]]:
    """Each pixel's two nearest cells (one cell of margin at both ends) and its share in them."""
    place = (np.arange(size) + 0.5) / cell_px + 0.5
    first = np.floor(place).astype(np.intp)
    share = place - first
    return np.stack([first, first + 1]), np.stack([1 - share, share])


def _normalised(signed: Channels) -> Channels:
    half = ORIENTATIONS // 2
    unsigned = signed[:half] + signed[half:]
    gains = _neighbourhood_gains(unsigned)
    # One long row each: numpy spends more on a new row than on the few cells in it.
    oriented = np.concatenate([signed, unsigned]).reshape(len(signed) + half, -1)
    features = np.zeros((CHANNELS, oriented.shape[1]), np.float32)
    clipped = np.empty_like(oriented)
    for texture, gain in zip(features[-4:], gains, strict=True):
        np.multiply(oriented, gain.ravel(), out=clipped)
        cv2.threshold(clipped, _CLIP, _CLIP, cv2.THRESH_TRUNC, dst=clipped)
        features[:-4] += clipped
        np.sum(clipped[:ORIENTATIONS], axis=0, out=texture)
    features[:-4] *= np.float32(0.5)
    features[-4:] *= np.float32(_TEXTURE_GAIN)
    return features.reshape(CHANNELS, *signed.shape[1:])


def _neighbourhood_gains(unsigned: Channels) -> list[Channels]:
    """One over the gradient energy of the four blocks of 2x2 cells about each cell."""
    inner = np.einsum("ijk,ijk->jk", unsigned, unsigned)
    energy = np.asarray(cv2.copyMakeBorder(inner, 1, 1, 1, 1, cv2.BORDER_REPLICATE), np.float32)
    blocks = energy[:-1, :-1] + energy[1:, :-1] + energy[:-1, 1:] + energy[1:, 1:]
    gain = 1 / np.sqrt(blocks + np.float32(1e-4))
    return [gain[:-1, :-1], gain[1:, :-1], gain[:-1, 1:], gain[1:, 1:]]
