"""The translation filter: a correlation filter that is trained on real background.

After Kiani Galoogahi, Fagg and Lucey, "Learning Background-Aware Correlation Filters for Visual
Tracking" (ICCV 2017): the filter covers the target alone, while every shift of the whole search
region serves as a sample, so that true surroundings, not wrapped copies of the target, are the
negatives. Solved by the alternating direction method of multipliers (ADMM).
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from follower_vision.correlation.gradients import Channels

Spectrum: TypeAlias = npt.NDArray[np.complex64]
"""Half spectra of the channels, shape (C, cells, cells // 2 + 1)."""

_PENALTY = 1.0
_PENALTY_GROWTH = 10.0


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
