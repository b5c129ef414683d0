"""The scale filter: a one-dimensional correlation filter over sizes.

After Danelljan, Häger, Khan and Felsberg, "Discriminative Scale Space Tracking" (PAMI 2017).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.box import Box
from follower_vision.correlation.gradients import GradientHistogram
from follower_vision.correlation.patch import cut
from follower_vision.correlation.peak import vertex
from follower_vision.frame import Image

Spectra: TypeAlias = npt.NDArray[np.complex64]
"""Half spectra along the sizes, shape (count // 2 + 1, features)."""

Map: TypeAlias = npt.NDArray[np.float32]

_TEMPLATE_AREA = 512.0
_CELL_PX = 4
_LABEL_SIGMA = 1 / 16


class ScaleFilter:
    """Learns how the target looks at one size and answers how much larger it has become.

    Args:
        box: the target, for its aspect ratio.
        count: number of sizes compared, odd.
        step: ratio of neighbouring sizes.
        regularisation: weight of the filter's norm.
    """

    def __init__(self, box: Box, count: int, step: float, regularisation: float) -> None:
        self._step = step
        self._regularisation = regularisation
        self._steps = np.arange(count) - count // 2
        self._factors = [float(factor) for factor in step ** self._steps.astype(np.float64)]
        label = np.exp(-0.5 * (self._steps / (count * _LABEL_SIGMA)) ** 2)
        self._label = np.fft.rfft(np.fft.ifftshift(label)).astype(np.complex64)
        turns = np.outer(np.fft.rfftfreq(count), np.arange(count))
        window = np.hanning(count + 2)[1:-1]
        self._transform = (np.exp(-2j * math.pi * turns) * window).astype(np.complex64)
        self._width, self._height = _template_size(box)
        self._size, self._views = _views(self._width, self._height, self._factors)
        self._gradients = GradientHistogram(self._height * count, self._width, _CELL_PX)
        self._numerator: Spectra | None = None
        self._energy: npt.NDArray[np.float32] = np.zeros(0, np.float32)

    def start(self, image: Image, box: Box) -> None:
        """Learn the target that `box` bounds."""
        sample = self._spectra(image, box)
        self._numerator, self._energy = self._products(sample)

    def update(self, image: Image, box: Box, rate: float) -> float:
        """Return the target's size over that of `box`, which has its centre, and learn it.

        Args:
            image: (H, W, 3) uint8 BGR.
            box: the target's centre and its last size.
            rate: share of this sample in the model.

        Raises:
            RuntimeError: `start` was not called.
        """
        if self._numerator is None:
            raise RuntimeError("the scale filter has learnt nothing")
        sample = self._spectra(image, box)
        factor = float(self._step ** self._peak((np.conj(self._numerator) * sample).sum(axis=1)))
        numerator, energy = self._products(self._spectra(image, box.scaled(factor)))
        self._numerator = self._numerator * np.float32(1 - rate) + numerator * np.float32(rate)
        self._energy = self._energy * np.float32(1 - rate) + energy * np.float32(rate)
        return factor

    def _products(self, sample: Spectra) -> tuple[Spectra, npt.NDArray[np.float32]]:
        energy = (sample.real**2 + sample.imag**2).sum(axis=1)
        return np.conj(self._label)[:, None] * sample, energy

    def _peak(self, summed: npt.NDArray[np.complex64]) -> float:
        """The best size in steps, with a fraction."""
        quotient = summed / (self._energy + np.float32(self._regularisation))
        response = np.fft.fftshift(np.fft.irfft(quotient, n=len(self._steps)))
        best = int(response.argmax())
        if not 0 < best < len(response) - 1:
            return float(self._steps[best])
        return float(self._steps[best]) + vertex(*response[best - 1 : best + 2])

    def _spectra(self, image: Image, box: Box) -> Spectra:
        count = len(self._factors)
        cells = self._gradients(self._stack(image, box))
        by_size = cells.reshape(len(cells), count, -1).transpose(1, 0, 2).reshape(count, -1)
        return self._transform @ by_size

    def _stack(self, image: Image, box: Box) -> npt.NDArray[np.uint8]:
        """Grey templates of all sizes, one under the other."""
        grey = cv2.cvtColor(
            cut(image, box.scaled(self._factors[-1]), *self._size), cv2.COLOR_BGR2GRAY
        )
        views = cv2.remap(grey, *self._views, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(views, np.uint8)


def _views(
    width: int, height: int, factors: Sequence[float]
) -> tuple[tuple[int, int], tuple[Map, Map]]:
    """Return the size of the largest template, and where in it the pixels of all templates lie.

    A pixel's centre is at (column + 0.5, row + 0.5) there; one template lies under the other.
    """
    largest = factors[-1]
    wide, tall = math.ceil(width * largest), math.ceil(height * largest)
    shares = np.array(factors)[:, None] / largest
    across = wide / 2 + wide * shares * ((np.arange(width) + 0.5) / width - 0.5) - 0.5
    down = tall / 2 + tall * shares * ((np.arange(height) + 0.5) / height - 0.5) - 0.5
    shape = len(factors), height, width
    columns = np.broadcast_to(across[:, None, :], shape).reshape(-1, width)
    rows = np.broadcast_to(down[:, :, None], shape).reshape(-1, width)
    return (wide, tall), (columns.astype(np.float32), rows.astype(np.float32))


def _template_size(box: Box) -> tuple[int, int]:
    """Width and height in pixels: whole cells, about the template's area, the box's aspect."""
    shrink = math.sqrt(_TEMPLATE_AREA / box.area)
    return _whole_cells(box.width * shrink), _whole_cells(box.height * shrink)


def _whole_cells(size: float) -> int:
    return min(64, max(2 * _CELL_PX, round(size / _CELL_PX) * _CELL_PX))
