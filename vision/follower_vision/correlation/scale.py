"""The scale filter: a one-dimensional correlation filter over sizes.

After Danelljan, Häger, Khan and Felsberg, "Discriminative Scale Space Tracking" (PAMI 2017).
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.box import Box
from follower_vision.correlation.gradients import GradientHistogram
from follower_vision.correlation.patch import cut, cut_grey
from follower_vision.correlation.peak import vertex
from follower_vision.frame import Image

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
        self._label = np.fft.fft(np.fft.ifftshift(label))
        self._window = np.hanning(count + 2)[1:-1, None]
        self._width, self._height = _template_size(box)
        self._gradients = GradientHistogram(self._height * count, self._width, _CELL_PX)
        self._numerator: npt.NDArray[np.complex128] | None = None
        self._energy: npt.NDArray[np.float64] = np.zeros(count)

    def learn(self, image: Image, box: Box, rate: float) -> None:
        """Blend the target, which `box` bounds, into the model."""
        sample = self._spectra(image, box)
        numerator = np.conj(self._label)[:, None] * sample
        energy = (np.abs(sample) ** 2).sum(axis=1)
        if self._numerator is None:
            self._numerator, self._energy = numerator, energy
        else:
            self._numerator = self._numerator * (1 - rate) + numerator * rate
            self._energy = self._energy * (1 - rate) + energy * rate

    def factor(self, image: Image, box: Box) -> float:
        """Return the target's size in `image` over that of `box`, which has its centre.

        Raises:
            RuntimeError: nothing was learnt.
        """
        if self._numerator is None:
            raise RuntimeError("the scale filter has learnt nothing")
        summed = (np.conj(self._numerator) * self._spectra(image, box)).sum(axis=1)
        response = np.fft.fftshift(np.fft.ifft(summed / (self._energy + self._regularisation)).real)
        best = int(response.argmax())
        offset = 0.0
        if 0 < best < len(response) - 1:
            offset = vertex(response[best - 1], response[best], response[best + 1])
        return float(self._step ** (self._steps[best] + offset))

    def _spectra(self, image: Image, box: Box) -> npt.NDArray[np.complex128]:
        """Spectra along the sizes, shape (count, features)."""
        count = len(self._factors)
        cells = self._gradients(self._stack(image, box))
        by_size = cells.reshape(len(cells), count, -1).transpose(1, 0, 2).reshape(count, -1)
        return np.asarray(np.fft.fft(by_size * self._window, axis=0))

    def _stack(self, image: Image, box: Box) -> npt.NDArray[np.uint8]:
        """Grey templates of all sizes, one under the other."""
        largest = self._factors[-1]
        wide, tall = math.ceil(self._width * largest), math.ceil(self._height * largest)
        grey = cv2.cvtColor(cut(image, box.scaled(largest), wide, tall), cv2.COLOR_BGR2GRAY)
        views = [
            cut_grey(
                np.asarray(grey, np.uint8),
                Box(wide / 2, tall / 2, wide * factor / largest, tall * factor / largest),
                self._width,
                self._height,
            )
            for factor in self._factors
        ]
        return np.concatenate(views)


def _template_size(box: Box) -> tuple[int, int]:
    """Width and height in pixels: whole cells, about the template's area, the box's aspect."""
    shrink = math.sqrt(_TEMPLATE_AREA / box.area)
    return _whole_cells(box.width * shrink), _whole_cells(box.height * shrink)


def _whole_cells(size: float) -> int:
    return min(64, max(2 * _CELL_PX, round(size / _CELL_PX) * _CELL_PX))
