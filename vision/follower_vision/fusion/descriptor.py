"""What a box shows, in numbers that can be compared: structure, colours, and network features."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.appearance.appearance import colour_histograms
from follower_vision.fusion.embedder import Embedder
from follower_vision.geometry.box import Box
from follower_vision.images.crop import crop
from follower_vision.images.frame import Image
from follower_vision.trackers.motion_tracker import ResponseMap

_SIDE = 24
_CELLS = 3
_FILL = (127.0, 127.0, 127.0)
_RECENT_RATE = 0.1

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True, slots=True, eq=False)
class Descriptors:
    """N boxes' contents.

    Attributes:
        patterns: (N, 576) grey pictures with mean 0 and length 1: products are normalised
            cross-correlations.
        colours: (N, 56) shares of colours, sum 1; see `colour_histograms`.
        features: (N, D) the motion tracker's or an embedder's, length 1; D = 0 if it has none.
    """

    patterns: Floats
    colours: Floats
    features: Floats


def describe(
    image: Image,
    boxes: list[Box],
    response: ResponseMap | None,
    embedder: Embedder | None = None,
) -> Descriptors:
    """Describe boxes in an image, (H, W, 3) uint8 BGR, in pixels; at least one.

    An embedder gives the features in place of the motion tracker.
    """
    patches = np.stack([crop(image, box, _SIDE, _SIDE, _FILL) for box in boxes])
    greys = cv2.cvtColor(patches.reshape(-1, _SIDE, 3), cv2.COLOR_BGR2GRAY)
    patterns = greys.reshape(len(boxes), -1).astype(np.float32)
    patterns -= patterns.mean(axis=1, keepdims=True)
    colours = colour_histograms(patches)
    if embedder is None:
        features = _network_features(boxes, response)
    else:
        features = embedder.embed(image, boxes)
    return Descriptors(_unit_rows(patterns), colours, features)


def _network_features(boxes: list[Box], response: ResponseMap | None) -> Floats:
    """Sample the searched region's features at 3 x 3 places of each box."""
    if response is None or response.image_features is None:
        return np.zeros((len(boxes), 0), np.float32)
    features, region = response.image_features, response.region
    rows, columns, channels = features.shape
    along = (np.arange(_CELLS) + 0.5) / _CELLS - 0.5
    places = np.array([[box.cx, box.cy, box.width, box.height] for box in boxes], np.float32)
    across = (places[:, :1] + along * places[:, 2:3] - region.left) / region.width * columns - 0.5
    down = (places[:, 1:2] + along * places[:, 3:4] - region.top) / region.height * rows - 0.5
    grid_x = np.repeat(across[:, None, :], _CELLS, axis=1).reshape(len(boxes), -1)
    grid_y = np.repeat(down[:, :, None], _CELLS, axis=2).reshape(len(boxes), -1)
    x0 = np.clip(np.floor(grid_x), 0, columns - 2).astype(int)
    y0 = np.clip(np.floor(grid_y), 0, rows - 2).astype(int)
    fx, fy = np.clip(grid_x - x0, 0, 1)[..., None], np.clip(grid_y - y0, 0, 1)[..., None]
    cells = np.ascontiguousarray(features)  # a network keeps each channel together
    top = cells[y0, x0] * (1 - fx) + cells[y0, x0 + 1] * fx
    bottom = cells[y0 + 1, x0] * (1 - fx) + cells[y0 + 1, x0 + 1] * fx
    sampled = (top * (1 - fy) + bottom * fy).reshape(len(boxes), _CELLS**2 * channels)
    # Features have a large common part; without it cosines tell things apart.
    common = np.tile(features.reshape(-1, channels).mean(axis=0), _CELLS**2)
    inside = (np.abs(places[:, 0] - region.cx) < region.width / 2) & (
        np.abs(places[:, 1] - region.cy) < region.height / 2
    )
    return _unit_rows((sampled - common) * inside[:, None])


def _unit_rows(rows: Floats) -> Floats:
    lengths = np.sqrt(np.einsum("ij,ij->i", rows, rows))
    return np.asarray(rows / np.maximum(lengths, 1e-6)[:, None])


class AppearanceMemory:
    """How the target looked at the start, and how lately."""

    def __init__(self, first: Descriptors) -> None:
        """Take the first view, a single row."""
        self._first = self._recent = first

    def learn(self, seen: Descriptors, row: int, probability: float) -> None:
        """Take a view into the recent memory, in proportion to the probability that it is right."""
        rate = _RECENT_RATE * probability
        recent = self._recent

        def blend(old: Floats, new: Floats) -> Floats:
            return np.asarray(old + rate * (new[row : row + 1] - old))

        features = seen.features[row]
        self._recent = Descriptors(
            _unit_rows(blend(recent.patterns, seen.patterns)),
            blend(recent.colours, seen.colours),
            _unit_rows(blend(recent.features, seen.features))
            if features.any()
            else recent.features,
        )

    def likeness(self, seen: Descriptors) -> Floats:
        """Return how alike N views are to the target, (N, 6), each at most 1.

        The columns are correlation, common colours and cosine of the features, each with the first
        view and then with the recent ones.
        """
        columns = []
        for known in (self._first, self._recent):
            columns.append(seen.patterns @ known.patterns[0])
            columns.append(np.minimum(seen.colours, known.colours).sum(axis=1))
            if seen.features.shape[1]:
                columns.append(seen.features @ known.features[0])
            else:
                columns.append(np.zeros(len(seen.patterns)))
        return np.stack(columns, axis=1)
