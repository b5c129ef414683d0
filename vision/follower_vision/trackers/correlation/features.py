"""The features of the correlation tracker: gradients and colours of cells, and colour histograms.

Gradients: Felzenszwalb, Girshick, McAllester and Ramanan, "Object Detection with Discriminatively
Trained Part-Based Models" (PAMI 2010): 18 signed and 9 unsigned orientations, each normalised by
its four neighbourhoods and clipped, and the energies of those neighbourhoods.

Colours: in the spirit of van de Weijer, Schmid, Verbeek and Larlus, "Learning Color Names for
Real-World Applications" (2009), but with a closed form in the place of their learnt table: a soft
vote by the distance to the prototype of each of eleven colours in CIE Lab, and the brightness.

Colour likelihood: Bertinetto, Valmadre, Golodetz, Miksik and Torr, "Staple: Complementary Learners
for Real-Time Tracking" (CVPR 2016): histograms hold no positions, so that they still match a target
that turns or bends, where a correlation filter alone fails.
"""

from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.images.frame import Image

Channels: TypeAlias = npt.NDArray[np.float32]
"""Feature channels, shape (C, rows, columns)."""

ORIENTATIONS = 18
GRADIENT_CHANNELS = ORIENTATIONS + ORIENTATIONS // 2 + 4
_CLIP = 0.2
_TEXTURE_GAIN = 0.2357
_DIFFERENCES = 511
_PROTOTYPES_RGB = (
    (0, 0, 0),
    (0, 0, 255),
    (110, 70, 40),
    (128, 128, 128),
    (0, 160, 0),
    (255, 140, 0),
    (255, 150, 190),
    (140, 0, 160),
    (230, 0, 0),
    (255, 255, 255),
    (255, 255, 0),
)
_LAB_SIGMA = 25.0
_LEVELS = 32
_PLACE = np.array([_LEVELS * _LEVELS, _LEVELS, 1])
_HISTOGRAM_LEVELS = 16
_SHIFT = 4
_HISTOGRAM_PLACE = np.array([_HISTOGRAM_LEVELS * _HISTOGRAM_LEVELS, _HISTOGRAM_LEVELS, 1])
_INNER_SHARE = 0.8
_EMPTY = 1e-5
_USELESS_GAP = 0.2
_USEFUL_GAP = 0.4
Histogram = npt.NDArray[np.float64]
Colours = npt.NDArray[np.intp]
"""The place of each pixel's colour in the histograms, (2 cells, 2 cells)."""


def _gradient_lookup() -> tuple[npt.NDArray[np.intp], npt.NDArray[np.float32]]:
    """Tables of orientation bin and magnitude over all pairs of 8-bit differences."""
    steps = np.arange(-255, 256)
    across, down = np.meshgrid(steps, steps, indexing="ij")
    turn = np.arctan2(down, across) / (2 * np.pi) * ORIENTATIONS
    bins = np.floor(turn + 0.5).astype(np.intp) % ORIENTATIONS
    magnitude = np.hypot(across, down) / 255
    return bins.ravel(), magnitude.ravel().astype(np.float32)


_BINS, _MAGNITUDE = _gradient_lookup()


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
    features = np.zeros((GRADIENT_CHANNELS, oriented.shape[1]), np.float32)
    clipped = np.empty_like(oriented)
    for texture, gain in zip(features[-4:], gains, strict=True):
        np.multiply(oriented, gain.ravel(), out=clipped)
        cv2.threshold(clipped, _CLIP, _CLIP, cv2.THRESH_TRUNC, dst=clipped)
        features[:-4] += clipped
        np.sum(clipped[:ORIENTATIONS], axis=0, out=texture)
    features[:-4] *= np.float32(0.5)
    features[-4:] *= np.float32(_TEXTURE_GAIN)
    return features.reshape(GRADIENT_CHANNELS, *signed.shape[1:])


def _neighbourhood_gains(unsigned: Channels) -> list[Channels]:
    """One over the gradient energy of the four blocks of 2x2 cells about each cell."""
    inner = np.einsum("ijk,ijk->jk", unsigned, unsigned)
    energy = np.asarray(cv2.copyMakeBorder(inner, 1, 1, 1, 1, cv2.BORDER_REPLICATE), np.float32)
    blocks = energy[:-1, :-1] + energy[1:, :-1] + energy[:-1, 1:] + energy[1:, 1:]
    gain = 1 / np.sqrt(blocks + np.float32(1e-4))
    return [gain[:-1, :-1], gain[1:, :-1], gain[:-1, 1:], gain[1:, 1:]]


def _lookup() -> npt.NDArray[np.float32]:
    """Votes and brightness, (32768, 12), by the upper five bits of blue, green and red; mean 0."""
    prototypes = np.array(_PROTOTYPES_RGB, np.float32)[None] / 255
    prototypes_lab = cv2.cvtColor(prototypes, cv2.COLOR_RGB2Lab)[0]
    level = (np.arange(_LEVELS, dtype=np.float32) + 0.5) / _LEVELS
    bgr = np.stack(np.meshgrid(level, level, level, indexing="ij"), axis=-1).reshape(1, -1, 3)
    lab = cv2.cvtColor(bgr, cv2.COLOR_BGR2Lab)[0]
    distance2 = ((lab[:, None] - prototypes_lab[None]) ** 2).sum(axis=-1)
    votes = np.exp(-distance2 / (2 * _LAB_SIGMA**2)) + 1e-9
    votes /= votes.sum(axis=1, keepdims=True)
    brightness = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY).reshape(-1, 1)
    table = np.concatenate([votes, brightness], axis=1)
    return np.asarray(table - table.mean(axis=0), np.float32)


_TABLE = _lookup()


class ColourTable:
    """Turns pixels into colour channels, by default into all twelve.

    Args:
        directions: combinations of the channels to answer instead, shape (C, 12).
    """

    def __init__(self, directions: npt.NDArray[np.float32] | None = None) -> None:
        self._table = _TABLE if directions is None else _TABLE @ directions.T

    def __call__(self, patch: Image, cells: int) -> Channels:
        """Return (C, cells, cells) of a square patch."""
        pixels = np.asarray(
            cv2.resize(patch, (2 * cells, 2 * cells), interpolation=cv2.INTER_AREA), np.uint8
        )
        votes = np.take(self._table, (pixels >> 3) @ _PLACE, axis=0)
        averaged = cv2.resize(votes, (cells, cells), interpolation=cv2.INTER_AREA)
        return np.ascontiguousarray(averaged.reshape(cells, cells, -1).transpose(2, 0, 1))


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
        self._directions = np.zeros((0, 0), np.float32)
        self._colours = ColourTable()
        rim = np.hanning(self._cells + 2)[1:-1]
        self._window = np.outer(rim, rim).astype(np.float32)

    def start(self, patch: Image) -> None:
        """Choose the components from the first patch."""
        gradient_channels, colour_channels = self._kept
        gradients = self._gradients(_grey(patch)) * self._window
        self._directions = _components(gradients, gradient_channels)
        colours = ColourTable()(patch, self._cells) * self._window
        self._colours = ColourTable(_components(colours, colour_channels))

    def __call__(self, patch: Image) -> Channels:
        """Return (channels, cells, cells), weighted by a cosine window."""
        gradients = self._gradients(_grey(patch))
        reduced = self._directions @ gradients.reshape(len(gradients), -1)
        gradients = reduced.reshape(-1, self._cells, self._cells)
        channels = np.concatenate([gradients, self._colours(patch, self._cells)])
        return np.asarray(channels * self._window, np.float32)


def _grey(patch: Image) -> npt.NDArray[np.uint8]:
    return np.asarray(cv2.cvtColor(patch, cv2.COLOR_BGR2GRAY), np.uint8)


def _components(channels: Channels, kept: int) -> npt.NDArray[np.float32]:
    """The `kept` strongest principal directions, shape (kept, C)."""
    samples = channels.reshape(len(channels), -1).astype(np.float64)
    _, directions = np.linalg.eigh(samples @ samples.T)
    return np.ascontiguousarray(directions[:, ::-1][:, :kept].T, np.float32)


class ColourLikelihood:
    """Histograms of the target's and its surroundings' colours.

    Args:
        cells: side of the search region in cells.
        target_columns: the target's width in cells.
        target_rows: the target's height in cells.
    """

    def __init__(self, cells: int, target_columns: float, target_rows: float) -> None:
        self._cells = cells
        self._pixels = 2 * cells
        self._width, self._height = 2 * target_columns, 2 * target_rows
        self._target: Histogram = np.zeros(_HISTOGRAM_LEVELS**3)
        self._around: Histogram = np.zeros(_HISTOGRAM_LEVELS**3)

    def colours_of(self, patch: Image) -> Colours:
        """Return the colours of a patch: the search region, square."""
        size = (self._pixels, self._pixels)
        pixels = np.asarray(cv2.resize(patch, size, interpolation=cv2.INTER_AREA), np.uint8)
        return np.asarray((pixels >> _SHIFT) @ _HISTOGRAM_PLACE, np.intp)

    def learn(self, seen: Colours, across: float, down: float, rate: float) -> None:
        """Blend a patch's colours into the histograms.

        Args:
            seen: the patch, as `colours_of` returned it.
            across: the target's place to the right of the patch's middle, in cells.
            down: its place below the middle, in cells.
            rate: share of this patch in the histograms, 1 for the first.
        """
        inside, around = self._regions(2 * across, 2 * down)
        self._target += rate * (_histogram(seen[inside]) - self._target)
        self._around += rate * (_histogram(seen[around]) - self._around)

    def usefulness(self) -> float:
        """Return how well colour separates the target from its surroundings, 0 (not at all) to 1.

        By the mean likelihood on the target less the mean around it, which is 0 for equal colours
        and 1 for colours without one in common; grey images and camouflage stay about 0.3.
        """
        gap = float((self._target - self._around) @ self._table())
        return min(1.0, max(0.0, (gap - _USELESS_GAP) / (_USEFUL_GAP - _USELESS_GAP)))

    def response(self, seen: Colours) -> npt.NDArray[np.float32]:
        """Return (cells, cells): the mean likelihood, 0 to 1, in the box at each shift from [0, 0].

        The shifts are cyclic, as those of a correlation filter's response.
        """
        likelihood = np.take(self._table().astype(np.float32), seen)
        size = (_odd(self._width), _odd(self._height))
        in_box = cv2.blur(likelihood, size, borderType=cv2.BORDER_REPLICATE)
        by_cell = cv2.resize(in_box, (self._cells, self._cells), interpolation=cv2.INTER_AREA)
        # The patch's middle is the corner of four cells.
        rows = by_cell + np.roll(by_cell, 1, axis=0)
        corners = (rows + np.roll(rows, 1, axis=1)) / 4
        return np.asarray(np.fft.ifftshift(corners), np.float32)

    def _table(self) -> Histogram:
        """The likelihood of each colour."""
        return self._target / (self._target + self._around + _EMPTY)

    def _regions(
        self, across: float, down: float
    ) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
        """The target's inner part, and a frame about it as wide as the target."""
        place = np.arange(self._pixels) + 0.5 - self._pixels / 2
        column, row = np.abs(place - across), np.abs(place - down)
        width, height = self._width / 2, self._height / 2
        margin = width + height
        inner = np.outer(
            row < max(1.0, height * _INNER_SHARE), column < max(1.0, width * _INNER_SHARE)
        )
        target = np.outer(row < height, column < width)
        near = np.outer(row < height + margin, column < width + margin)
        return inner, near & ~target


def _histogram(colours: Colours) -> Histogram:
    return np.bincount(colours, minlength=_HISTOGRAM_LEVELS**3) / max(1, len(colours))


def _odd(size: float) -> int:
    """The nearest odd number, so that a window has a middle."""
    return 2 * max(0, round((size - 1) / 2)) + 1
