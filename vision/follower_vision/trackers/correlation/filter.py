"""The correlation filters: one for the target's position, one for its size.

Position: Kiani Galoogahi, Fagg and Lucey, "Learning Background-Aware Correlation Filters for Visual
Tracking" (ICCV 2017): the filter covers the target alone, while every shift of the whole search
region serves as a sample, so that true surroundings, not wrapped copies of the target, are the
negatives. Solved by the alternating direction method of multipliers (ADMM).

Size: Danelljan, Häger, Khan and Felsberg, "Discriminative Scale Space Tracking" (PAMI 2017): a
one-dimensional correlation filter over sizes.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.geometry.box import Box
from follower_vision.images.crop import crop
from follower_vision.images.frame import Image
from follower_vision.trackers.correlation.features import Channels, GradientHistogram

Spectrum: TypeAlias = npt.NDArray[np.complex64]
"""Half spectra of the channels, shape (C, cells, cells // 2 + 1)."""

_PENALTY = 1.0
_PENALTY_GROWTH = 10.0
Response = npt.NDArray[np.float32]
"""Evidence by shift, shape (rows, columns), cyclic in both directions; shift 0 is at [0, 0]."""
Spectra: TypeAlias = npt.NDArray[np.complex64]
"""Half spectra along the sizes, shape (count // 2 + 1, features)."""
Map: TypeAlias = npt.NDArray[np.float32]
_TEMPLATE_AREA = 512.0
_CELL_PX = 4
_LABEL_SIGMA = 1 / 16


def spectrum(channels: Channels) -> Spectrum:
    """Return the half spectra of real channels."""
    return np.asarray(np.fft.rfft2(channels), np.complex64)


class BackgroundAwareFilter:
    """Learns a target from spectra of its surroundings and answers where it is in new ones.

    Args:
        cells: side of the search region in cells.
        target_columns: the target's width in cells.
        target_rows: the target's height in cells.
        label_sigma: width of the wanted response in cells.
        regularisation: weight of the filter's norm.
        iterations: ADMM iterations per training.
    """

    def __init__(
        self,
        cells: int,
        target_columns: float,
        target_rows: float,
        label_sigma: float,
        regularisation: float,
        iterations: int,
    ) -> None:
        self._cells = cells
        self._iterations = iterations
        self._regularisation = regularisation
        self._label = _gaussian_spectrum(cells, label_sigma)
        across = _covers(cells, target_columns)
        self._support = np.outer(_covers(cells, target_rows), across).astype(np.float32)
        self._model: Spectrum | None = None
        self._filter: Spectrum | None = None

    def learn(self, sample: Spectrum, rate: float) -> None:
        """Blend a sample, whose target is in the middle, into the model and train the filter."""
        if self._model is None:
            self._model = sample
        else:
            self._model = self._model * np.float32(1 - rate) + sample * np.float32(rate)
        self._filter = self._trained(self._model)

    def response(self, sample: Spectrum) -> npt.NDArray[np.float32]:
        """Return (cells, cells): evidence for the target at each shift; shift 0 is at [0, 0].

        Raises:
            RuntimeError: nothing was learnt.
        """
        if self._filter is None:
            raise RuntimeError("the filter has learnt nothing")
        summed = (np.conj(self._filter) * sample).sum(axis=0)
        return np.asarray(np.fft.irfft2(summed, s=(self._cells, self._cells)), np.float32)

    def _trained(self, model: Spectrum) -> Spectrum:
        """Solve for the filter: free over all cells, supported on the target alone, both equal."""
        count = self._cells**2
        energy = (model.real**2 + model.imag**2).sum(axis=0)
        target = model * (self._label / np.float32(count))
        multiplier = np.zeros_like(model)
        penalty = _PENALTY
        free = _fitted(model, energy, target, penalty, count)
        for _ in range(self._iterations - 1):
            supported = self._on_target(penalty * free + multiplier, penalty)
            multiplier = multiplier + penalty * (free - supported)
            penalty *= _PENALTY_GROWTH
            wanted = target + penalty * supported - multiplier
            free = _fitted(model, energy, wanted, penalty, count)
        return free

    def _on_target(self, whole: Spectrum, penalty: float) -> Spectrum:
        cells = np.fft.irfft2(whole, s=(self._cells, self._cells))
        return spectrum(cells * (self._support / np.float32(self._regularisation + penalty)))


def _fitted(
    model: Spectrum,
    energy: npt.NDArray[np.float32],
    wanted: Spectrum,
    penalty: float,
    count: int,
) -> Spectrum:
    """Solve each frequency's system of rank one by the Sherman-Morrison formula."""
    shared = (np.conj(model) * wanted).sum(axis=0) / (penalty * count + energy)
    return np.asarray((wanted - model * shared) / np.float32(penalty), np.complex64)


def _gaussian_spectrum(cells: int, sigma: float) -> Spectrum:
    shift = np.fft.fftfreq(cells) * cells
    line = np.exp(-0.5 * (shift / sigma) ** 2)
    return np.asarray(np.fft.rfft2(np.outer(line, line)), np.complex64).real.astype(np.complex64)


def _covers(cells: int, target: float) -> npt.NDArray[np.bool_]:
    """Which of the cells along one side lie on a target in the middle, at least two."""
    offsets: npt.NDArray[np.float64] = np.abs(np.arange(cells) - cells / 2 + 0.5)
    return offsets <= max(1.0, target / 2)


@dataclass(frozen=True, slots=True)
class Peak:
    """The highest point of a response.

    Attributes:
        across: shift to the right in cells, with a fraction.
        down: shift downwards in cells, with a fraction.
    """

    across: float
    down: float


def find_peak(response: Response) -> Peak:
    """Return a response's peak."""
    rows, columns = response.shape
    row, column = divmod(int(response.argmax()), columns)
    height = response[row, column]
    down = row + vertex(response[row - 1, column], height, response[(row + 1) % rows, column])
    right = response[row, (column + 1) % columns]
    across = column + vertex(response[row, column - 1], height, right)
    return Peak(
        across - columns if across > columns / 2 else across,
        down - rows if down > rows / 2 else down,
    )


def vertex(before: float, at: float, after: float) -> float:
    """Return where the parabola through three equidistant values peaks, -0.5 to 0.5."""
    bend = float(before) - 2 * float(at) + float(after)
    if bend >= 0:
        return 0.0
    return min(0.5, max(-0.5, 0.5 * (float(before) - float(after)) / bend))


def sidelobe_ratio(response: Response, lobe: int) -> float:
    """Return the peak's height over the rest's mean, in the rest's standard deviations.

    After Bolme, Beveridge, Draper and Lui, "Visual Object Tracking using Adaptive Correlation
    Filters" (CVPR 2010).

    Args:
        response: cyclic; 0 is returned for a flat one.
        lobe: half the side of the square about the peak that is left out, in cells.
    """
    rows, columns = response.shape
    row, column = divmod(int(response.argmax()), columns)
    centred = np.roll(response, (rows // 2 - row, columns // 2 - column), axis=(0, 1))
    aside = np.ones(response.shape, np.bool_)
    lobe_rows = slice(max(0, rows // 2 - lobe), rows // 2 + lobe + 1)
    lobe_columns = slice(max(0, columns // 2 - lobe), columns // 2 + lobe + 1)
    aside[lobe_rows, lobe_columns] = False
    rest = centred[aside]
    if rest.size == 0:
        return 0.0
    return float((response[row, column] - rest.mean()) / (rest.std() + 1e-9))


def cut(image: Image, region: Box, width: int, height: int) -> Image:
    """Return `region` of `image` scaled to `width` x `height` pixels.

    Regions more than twice as large as the result are averaged first, so that shrinking does not
    alias. What lies outside the image repeats its border.
    """
    shrink = int(min(region.width / width, region.height / height))
    if shrink >= 2:
        image, region = _shrunk(image, region, min(4, shrink & ~1))
    return crop(image, region, width, height)


def _shrunk(image: Image, region: Box, shrink: int) -> tuple[Image, Box]:
    """The part of the image under `region`, averaged in blocks, and the region in it."""
    left, right = _span(region.left, region.right, image.shape[1], shrink)
    top, bottom = _span(region.top, region.bottom, image.shape[0], shrink)
    size = ((right - left) // shrink, (bottom - top) // shrink)
    small = cv2.resize(image[top:bottom, left:right], size, interpolation=cv2.INTER_AREA)
    inside = Box(
        (region.cx - left) / shrink,
        (region.cy - top) / shrink,
        region.width / shrink,
        region.height / shrink,
    )
    return np.asarray(small, np.uint8), inside


def _span(low: float, high: float, size: int, shrink: int) -> tuple[int, int]:
    """Pixels `first` to `last` that cover [low, high] with a margin, whole blocks, in the image."""
    margin = 2 * shrink
    first = min(max(0, math.floor(low) - margin), max(0, size - shrink))
    last = max(min(size, math.ceil(high) + margin), first + shrink)
    return first, first + (last - first) // shrink * shrink


class ScaleFilter:
    """Learns the target at one size and returns how much larger it has become.

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

    def factor(self, image: Image, box: Box) -> float:
        """Return the target's size over that of `box`, which has its centre.

        Args:
            image: (H, W, 3) uint8 BGR.
            box: the target's centre and its last size.

        Raises:
            RuntimeError: `start` was not called.
        """
        if self._numerator is None:
            raise RuntimeError("the scale filter has learnt nothing")
        sample = self._spectra(image, box)
        return float(self._step ** self._peak((np.conj(self._numerator) * sample).sum(axis=1)))

    def learn(self, image: Image, box: Box, rate: float) -> None:
        """Learn the target that `box` bounds, with this share of the sample in the model.

        Raises:
            RuntimeError: `start` was not called.
        """
        if self._numerator is None:
            raise RuntimeError("the scale filter has learnt nothing")
        numerator, energy = self._products(self._spectra(image, box))
        self._numerator = self._numerator * np.float32(1 - rate) + numerator * np.float32(rate)
        self._energy = self._energy * np.float32(1 - rate) + energy * np.float32(rate)

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
