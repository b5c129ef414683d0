"""The appearance of a target: a small grey picture and a histogram of its colours."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.geometry.box import Box
from follower_vision.images.crop import crop
from follower_vision.images.frame import Image

_HUES = 16
_SATURATIONS = 3
_GREYS = 8
_COLOURS = _HUES * _SATURATIONS
_BINS = _COLOURS + _GREYS
_TOGETHER = np.ones((1, 3), np.float32)
_LEAST_SATURATION = 48
_LEAST_VALUE = 32
_LEAST_DEVIATION = 2.0
_FILL = (127.0, 127.0, 127.0)
_FINEST = 3
_MIDDLE = 128.0

Grey = npt.NDArray[np.uint8]
Histogram = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Appearance:
    """One view of a target.

    Attributes:
        grey: (h, w) uint8, the box's content at a standard size.
        histogram: shares of colours, sum 1; see `colour_histogram`.
    """

    grey: Grey
    histogram: Histogram


def standard_size(box: Box, side_px: float) -> tuple[int, int]:
    """Return (width, height) of the box's proportions with the area of a square of `side_px`."""
    across = math.sqrt(min(4.0, max(0.25, box.width / box.height)))
    return max(4, round(side_px * across)), max(4, round(side_px / across))


def appearance_of(image: Image, box: Box, size: tuple[int, int], margin: float = 0.0) -> Appearance:
    """Return what the box shows, resized to `size`.

    Args:
        image: (H, W, 3) uint8 BGR.
        box: in the image's pixels; what lies outside the image becomes grey.
        size: (width, height) of the picture in pixels, without the margin.
        margin: how much of the surroundings the grey picture takes in on each side, as a share of
            the side. The histogram is of the box alone.
    """
    across, down = round(size[0] * margin), round(size[1] * margin)
    wide, tall = size[0] + 2 * across, size[1] + 2 * down
    region = Box(box.cx, box.cy, box.width * wide / size[0], box.height * tall / size[1])
    patch = _resampled(image, region, wide, tall)
    inner = patch[down : down + size[1], across : across + size[0]]
    grey = np.asarray(cv2.cvtColor(patch, cv2.COLOR_BGR2GRAY), np.uint8)
    return Appearance(grey, colour_histogram(inner))


class AppearanceGallery:
    """Several views of one target, ready to be compared with what is seen."""

    def __init__(self, views: Sequence[Appearance]) -> None:
        """Take the views; all their pictures have one size."""
        self._size = views[0].grey.shape
        self._patterns = _patterns([view.grey for view in views])
        self._histograms = np.stack([view.histogram for view in views])

    def likeness(self, seen: Appearance) -> float:
        """Return the largest likeness to a view, -1 to 2: correlation plus common colours."""
        alike = _correlations(self._patterns, self._size, seen.grey)
        return float((alike + intersections(self._histograms, seen.histogram)).max())


def intersections(
    histograms: Sequence[Histogram] | Histogram, other: Histogram
) -> npt.NDArray[np.float64]:
    """Return how much each histogram has in common with another, shape (number,), 0 to 1."""
    return np.asarray(np.minimum(histograms, other).sum(axis=1))


def colour_histogram(image: Image) -> Histogram:
    """Return the shares of colours in an image's middle ellipse, shape (56,), sum 1.

    Pixels of little saturation or brightness have no reliable hue and are counted by brightness in
    bins of their own, so that grey images compare as well. Neighbouring bins share a part, so that
    a slight change of light does not move a colour to where it matches nothing.
    """
    return np.asarray(colour_histograms(image[None])[0])


def colour_histograms(images: Image) -> Histogram:
    """Return the `colour_histogram` of each of (N, H, W, 3) images, (N, 56)."""
    count, height, width, _ = images.shape
    below = images.reshape(count * height, width, 3)
    bins = histogram_bins(np.asarray(cv2.cvtColor(below, cv2.COLOR_BGR2HSV), np.uint8))
    weights, smoothing = _ellipse(height, width).ravel(), _smoothing()
    each = (np.bincount(row, weights, minlength=_BINS) for row in bins.reshape(count, -1))
    return np.stack([smoothing @ shares for shares in each])


def histogram_bins(hsv: npt.NDArray[np.uint8]) -> npt.NDArray[np.intp]:
    """Return the histogram's bin of every pixel, (H, W), of an (H, W, 3) HSV image (H < 180)."""
    cells = np.asarray(cv2.transform(cv2.LUT(hsv, _cell_table()), _TOGETHER), np.uint16)
    return _cell_bins().take(cells)


@lru_cache(maxsize=1)
def _cell_table() -> npt.NDArray[np.uint16]:
    """What each hue, saturation and value adds to the number of a pixel's cell, (256, 1, 3).

    Saturations and values have one step more than the histogram: the first one, without a hue.
    """
    level = np.arange(256)
    hue = np.minimum(level * _HUES // 180, _HUES - 1)
    depth = (level - _LEAST_SATURATION) * _SATURATIONS // (256 - _LEAST_SATURATION)
    saturation = np.where(level < _LEAST_SATURATION, 0, 1 + depth)
    dark = (level < _LEAST_VALUE).astype(int)
    value = 2 * (level * _GREYS // 256) + dark
    columns = [hue * (_SATURATIONS + 1) * 2 * _GREYS, saturation * 2 * _GREYS, value]
    return np.stack(columns, axis=1)[:, None].astype(np.uint16)


@lru_cache(maxsize=1)
def _cell_bins() -> npt.NDArray[np.intp]:
    """The histogram's bin of each cell."""
    hue, saturation, value = np.indices((_HUES, _SATURATIONS + 1, 2 * _GREYS))
    pale = (saturation == 0) | (value % 2 == 1)
    colour = hue * _SATURATIONS + saturation - 1
    return np.asarray(np.where(pale, _COLOURS + value // 2, colour).ravel())


@lru_cache(maxsize=1)
def _smoothing() -> npt.NDArray[np.float64]:
    """The matrix by which neighbouring bins share, (56, 56); the hues are a ring."""
    hues = np.eye(_HUES)
    hues = (2 * hues + np.roll(hues, 1, 0) + np.roll(hues, -1, 0)) / 4
    greys = np.pad(np.eye(_GREYS), ((1, 1), (0, 0)), "edge")
    matrix = np.zeros((_BINS, _BINS))
    matrix[:_COLOURS, :_COLOURS] = np.kron(hues, np.eye(_SATURATIONS))
    matrix[_COLOURS:, _COLOURS:] = (greys[:-2] + 2 * greys[1:-1] + greys[2:]) / 4
    return matrix


def _patterns(templates: Sequence[Grey]) -> npt.NDArray[np.float32]:
    """Each template as a row with mean 0 and length 1, 0 without structure; then a row of ones."""
    rows = np.stack(templates).reshape(len(templates), -1).astype(np.float32)
    rows -= rows.mean(axis=1, keepdims=True)
    squares = np.einsum("ij,ij->i", rows, rows)
    rows /= np.sqrt(np.maximum(squares, 1.0))[:, None]
    rows[_structureless(squares, rows.shape[1])] = 0.0
    return np.concatenate([rows, np.ones_like(rows[:1])])


def _correlations(
    patterns: npt.NDArray[np.float32], size: tuple[int, ...], picture: Grey
) -> npt.NDArray[np.float64]:
    # Near zero, sums of squares keep their digits. The windows' own means need not be taken off
    # for the products: those of the patterns are 0.
    windows = _windows(np.subtract(picture, _MIDDLE, dtype=np.float32), size)
    products = patterns @ windows.T
    alike, sums = products[:-1], products[-1]
    squares = np.einsum("ij,ij->i", windows, windows) - sums * sums / windows.shape[1]
    alike /= np.sqrt(np.maximum(squares, 1.0))
    alike[:, _structureless(squares, windows.shape[1])] = 0.0
    return np.asarray(alike.max(axis=1), np.float64)


def _structureless(squares: npt.NDArray[np.float32], count: int) -> npt.NDArray[np.bool_]:
    return np.asarray(squares <= _LEAST_DEVIATION**2 * count)


def _windows(picture: npt.NDArray[np.float32], size: tuple[int, ...]) -> npt.NDArray[np.float32]:
    """Every second place of a window in a picture, the middle one included, a row each."""
    down, across = (picture.shape[0] - size[0]) % 4 // 2, (picture.shape[1] - size[1]) % 4 // 2
    rows = (picture.shape[0] - size[0] - down) // 2 + 1
    columns = (picture.shape[1] - size[1] - across) // 2 + 1
    tall, wide = picture.strides
    places = np.lib.stride_tricks.as_strided(
        picture[down:, across:], (rows, columns, *size), (2 * tall, 2 * wide, tall, wide)
    )
    return places.reshape(rows * columns, -1)


@lru_cache(maxsize=32)
def _ellipse(height: int, width: int) -> npt.NDArray[np.float64]:
    """Weights, sum 1, that leave out the box's corners, where mostly background is."""
    y = (np.arange(height) + 0.5) / height * 2 - 1
    x = (np.arange(width) + 0.5) / width * 2 - 1
    weights = np.clip(1.2 - (x[None, :] ** 2 + y[:, None] ** 2), 0, 1)
    return np.asarray(weights / weights.sum())


def _resampled(image: Image, region: Box, wide: int, tall: int) -> Image:
    """Cut at about the image's own resolution first, so that a reduction averages pixels.

    The finer size is a multiple of the wanted one: such a reduction is quick.
    """
    fine_wide = min(max(1, round(region.width / wide)), _FINEST) * wide
    fine_tall = min(max(1, round(region.height / tall)), _FINEST) * tall
    fine = crop(image, region, fine_wide, fine_tall, _FILL)
    if (fine_wide, fine_tall) == (wide, tall):
        return fine
    return np.asarray(cv2.resize(fine, (wide, tall), interpolation=cv2.INTER_AREA), np.uint8)
