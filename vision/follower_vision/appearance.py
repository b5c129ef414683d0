"""What a target looks like: a small grey picture and a histogram of its colours."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.box import Box
from follower_vision.crop import crop
from follower_vision.frame import Image

_HUES = 16
_SATURATIONS = 3
_GREYS = 8
_LEAST_SATURATION = 48
_LEAST_VALUE = 32
_LEAST_DEVIATION = 2.0
_FILL = (127.0, 127.0, 127.0)
_FINEST = 3

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


def look(image: Image, box: Box, size: tuple[int, int], margin: float = 0.0) -> Appearance:
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


def correlations(templates: Sequence[Grey], picture: Grey) -> npt.NDArray[np.float64]:
    """Return, for each template, its best normalised cross-correlation within a picture.

    A template, or a place in the picture, without structure correlates with nothing: 0.

    Args:
        templates: (h, w) uint8 each, all of one size.
        picture: (H, W) uint8, at least as large; every second shift is tried.

    Returns:
        Shape (number of templates,), -1 to 1.
    """
    size = templates[0].shape
    down, across = (picture.shape[0] - size[0]) % 4 // 2, (picture.shape[1] - size[1]) % 4 // 2
    places = np.lib.stride_tricks.sliding_window_view(picture, size)[down::2, across::2]
    windows = _normalised(places.reshape(-1, size[0] * size[1]))
    known = _normalised(np.stack(templates).reshape(len(templates), -1))
    return np.asarray((known @ windows.T).max(axis=1), np.float64)


def intersections(histograms: Sequence[Histogram], other: Histogram) -> npt.NDArray[np.float64]:
    """Return how much each histogram has in common with another, shape (number,), 0 to 1."""
    return np.asarray(np.minimum(np.stack(histograms), other).sum(axis=1))


def colour_histogram(image: Image) -> Histogram:
    """Return the shares of colours in an image's middle ellipse, shape (56,), sum 1.

    Pixels of little saturation or brightness have no reliable hue and are counted by brightness in
    bins of their own, so that grey images compare as well. Neighbouring bins share a part, so that
    a slight change of light does not move a colour to where it matches nothing.
    """
    bins = histogram_bins(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2HSV), np.uint8))
    weights = _ellipse(image.shape[0], image.shape[1])
    counts = np.bincount(
        bins.ravel(), weights.ravel(), minlength=_HUES * _SATURATIONS + _GREYS
    ).astype(np.float64)
    colours = counts[: _HUES * _SATURATIONS].reshape(_HUES, _SATURATIONS)
    colours = (2 * colours + np.roll(colours, 1, 0) + np.roll(colours, -1, 0)) / 4
    greys = np.convolve(np.pad(counts[_HUES * _SATURATIONS :], 1, "edge"), (0.25, 0.5, 0.25))[2:-2]
    smooth = np.concatenate([colours.ravel(), greys])
    return np.asarray(smooth / max(smooth.sum(), 1e-12))


def histogram_bins(hsv: npt.NDArray[np.uint8]) -> npt.NDArray[np.intp]:
    """Return the histogram's bin of every pixel, (H, W), of an (H, W, 3) HSV image (H < 180)."""
    hue, saturation, value = hsv[..., 0], hsv[..., 1], hsv[..., 2]
    pale = (saturation < _LEAST_SATURATION) | (value < _LEAST_VALUE)
    ring = hue.astype(np.intp) * _HUES // 180
    depth = (
        (saturation.astype(np.intp) - _LEAST_SATURATION) * _SATURATIONS // (256 - _LEAST_SATURATION)
    )
    grey = _HUES * _SATURATIONS + value.astype(np.intp) * _GREYS // 256
    return np.where(pale, grey, ring * _SATURATIONS + depth)


def _normalised(rows: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
    """Each row with mean 0 and length 1; 0 where there is no structure."""
    centred = rows.astype(np.float32)
    centred -= centred.mean(axis=1, keepdims=True)
    length = np.sqrt(np.einsum("ij,ij->i", centred, centred))
    usable = length > _LEAST_DEVIATION * math.sqrt(rows.shape[1])
    centred *= np.divide(1.0, length, out=np.zeros_like(length), where=usable)[:, None]
    return centred


@lru_cache(maxsize=32)
def _ellipse(height: int, width: int) -> npt.NDArray[np.float64]:
    """Weights that leave out the box's corners, where mostly background is."""
    y = (np.arange(height) + 0.5) / height * 2 - 1
    x = (np.arange(width) + 0.5) / width * 2 - 1
    return np.asarray(np.clip(1.2 - (x[None, :] ** 2 + y[:, None] ** 2), 0, 1))


def _resampled(image: Image, region: Box, wide: int, tall: int) -> Image:
    """Cut at about the image's own resolution first, so that a reduction averages pixels."""
    fine_wide = min(max(wide, round(region.width)), _FINEST * wide)
    fine_tall = min(max(tall, round(region.height)), _FINEST * tall)
    fine = crop(image, region, fine_wide, fine_tall, _FILL)
    if (fine_wide, fine_tall) == (wide, tall):
        return fine
    return np.asarray(cv2.resize(fine, (wide, tall), interpolation=cv2.INTER_AREA), np.uint8)
