"""What a decoder reads out of a network's answer, before overlapping boxes are removed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from follower_vision.network import Tensor


@dataclass(frozen=True, slots=True)
class Candidates:
    """N boxes in pixels of the network's input.

    Attributes:
        corners: (N, 4) left, top, right, bottom.
        scores: (N,) 0 to 1.
        classes: (N,) class numbers.
    """

    corners: Tensor
    scores: Tensor
    classes: npt.NDArray[np.intp]

    def above(self, score: float) -> Candidates:
        """Return those with at least this score."""
        return self._chosen(self.scores >= score)

    def sound(self) -> Candidates:
        """Return those whose boxes are finite and have an area."""
        finite = self._chosen(np.isfinite(self.corners).all(axis=1))
        sides = finite.corners[:, 2:] - finite.corners[:, :2]
        return finite._chosen((sides > 0).all(axis=1))

    def _chosen(self, good: npt.ArrayLike) -> Candidates:
        rows = np.flatnonzero(good)
        return Candidates(self.corners[rows], self.scores[rows], self.classes[rows])


def from_centres(centres: Tensor, sizes: Tensor) -> Tensor:
    """Return corners, (N, 4), of boxes given by centre and size, each (N, 2)."""
    half = sizes / 2
    return np.hstack([centres - half, centres + half])


def best_class(scores: Tensor) -> tuple[Tensor, npt.NDArray[np.intp]]:
    """Return each row's largest value and its place, of (N, classes)."""
    classes = scores.argmax(axis=1)
    return np.take_along_axis(scores, classes[:, None], axis=1)[:, 0], classes


def sigmoid(values: Tensor) -> Tensor:
    """Return 1 / (1 + exp(-x)) without overflow."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * values)), dtype=np.float32)


def softmax(values: Tensor) -> Tensor:
    """Return the softmax over the last axis."""
    powers = np.exp(values - values.max(axis=-1, keepdims=True))
    return np.asarray(powers / powers.sum(axis=-1, keepdims=True), dtype=np.float32)


def grid_points(height: int, width: int) -> Tensor:
    """Return column and row of each cell of a grid, (height * width, 2), row by row."""
    across, down = np.meshgrid(np.arange(width), np.arange(height))
    return np.stack([across.ravel(), down.ravel()], axis=1).astype(np.float32)
