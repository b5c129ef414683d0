"""Searches a part of an image for a picture of the target, at several sizes."""

import math
from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.appearance.appearance import colour_histogram, histogram_bins
from follower_vision.geometry.box import Box
from follower_vision.images.crop import crop, halved, reduced
from follower_vision.images.frame import Image

_TEMPLATE_SIDE = 14.0
_PEAKS = 2
_LEAST_CORRELATION = 0.4
_LEAST_DEVIATION = 3.0
_MOST_SIDE = 240
_LEAST_SIDE = 7.0
_MOST_PIXELS = 320 * 240
_MOST_PIXELS_SMALL_TARGET = 640 * 480
_COLOUR_SEARCH_PEAKS = 3
_LEAST_SHARE_OF_OWN = 0.45
_LEAST_CONTRAST = 3.0
_FILL = (127.0, 127.0, 127.0)
_SIDE = 24


class TemplateSearch:
    """Normalised cross-correlation with one view of the target, reduced to about 14 pixels.

    One call searches one place of at most 240 x 240 reduced pixels, so that its time is bounded
    however large the image is.
    """

    def __init__(self) -> None:
        self._template: npt.NDArray[np.uint8] | None = None
        self._box = Box(0, 0, 1, 1)
        self._factor = 1.0

    def learn(self, image: Image, box: Box) -> None:
        """Take the view to search for, (H, W, 3) uint8 BGR; a view without structure is none."""
        self._box = box
        self._factor = min(1.0, _TEMPLATE_SIDE / box.scale)
        patch = _reduced_grey(image, box, self._factor)
        usable = patch is not None and min(patch.shape[:2]) >= 4 and patch.std() > _LEAST_DEVIATION
        self._template = patch if usable else None

    @property
    def reach_px(self) -> float:
        """Side of the largest square that one call searches, in the image's pixels."""
        return _MOST_SIDE / self._factor

    def candidates(
        self,
        image: Image,
        centre: tuple[float, float],
        reach_px: float,
        scales: Sequence[float] = (1.0,),
    ) -> list[Box]:
        """Return the most similar boxes in a square about a point, the most similar first.

        Args:
            image: (H, W, 3) uint8 BGR.
            centre: of the square, (x, y) in pixels.
            reach_px: side of the square; more than `self.reach_px` is cut to that.
            scales: sizes to search for, relative to the view's.
        """
        side = min(reach_px, self.reach_px)
        region = _inside(Box(centre[0], centre[1], side, side), image)
        if self._template is None or region is None:
            return []
        place = _reduced_grey(image, region, self._factor)
        if place is None:
            return []
        found = [
            peak for scale in scales for peak in self._peaks(place, self._template, scale, region)
        ]
        return [box for _, box in sorted(found, key=lambda pair: -pair[0])]

    def _peaks(
        self,
        place: npt.NDArray[np.uint8],
        template: npt.NDArray[np.uint8],
        scale: float,
        region: Box,
    ) -> list[tuple[float, Box]]:
        sized = cv2.resize(template, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        tall, wide = sized.shape[:2]
        if tall > place.shape[0] or wide > place.shape[1] or min(tall, wide) < 3:
            return []
        response = np.asarray(cv2.matchTemplate(place, sized, cv2.TM_CCOEFF_NORMED), np.float32)
        response[~np.isfinite(response)] = 0
        found = []
        for value, x, y in _maxima(response, max(wide, tall) // 2):
            across = region.width / place.shape[1]
            down = region.height / place.shape[0]
            cx, cy = region.left + (x + wide / 2) * across, region.top + (y + tall / 2) * down
            found.append((value, self._box.scaled(scale).moved_to(cx, cy)))
        return found


def tiles(width: int, height: int, side_px: float) -> list[tuple[float, float]]:
    """Return the centres of squares that cover an image, overlapping by a quarter at least."""
    across = max(1, math.ceil((width - side_px / 4) / (0.75 * side_px)))
    down = max(1, math.ceil((height - side_px / 4) / (0.75 * side_px)))
    return [
        ((column + 0.5) * width / across, (row + 0.5) * height / down)
        for row in range(down)
        for column in range(across)
    ]


def _maxima(response: npt.NDArray[np.float32], apart: int) -> list[tuple[float, int, int]]:
    """The highest values (value, x, y), each at least `apart` from the others."""
    left = response.copy()
    found = []
    for _ in range(_PEAKS):
        _, value, _, (x, y) = cv2.minMaxLoc(left)
        if value < _LEAST_CORRELATION:
            break
        found.append((float(value), int(x), int(y)))
        left[max(0, y - apart) : y + apart + 1, max(0, x - apart) : x + apart + 1] = -1
    return found


def _inside(region: Box, image: Image) -> Box | None:
    """The part of a region within the image, in whole pixels; None if that is nothing."""
    height, width = image.shape[:2]
    left, right = max(0, math.floor(region.left)), min(width, math.ceil(region.right))
    top, bottom = max(0, math.floor(region.top)), min(height, math.ceil(region.bottom))
    if right - left < 2 or bottom - top < 2:
        return None
    return Box.from_xywh(left, top, right - left, bottom - top)


def _reduced_grey(image: Image, region: Box, factor: float) -> npt.NDArray[np.uint8] | None:
    """A region of the image in grey at the search's size; None if it lies outside."""
    whole = _inside(region, image)
    if whole is None:
        return None
    x, y, w, h = (round(value) for value in whole.xywh)
    cut = image[y : y + h, x : x + w]
    if factor < 1:
        cut = reduced(cut, max(1, round(w * factor)), max(1, round(h * factor)))
    return np.asarray(cv2.cvtColor(cut, cv2.COLOR_BGR2GRAY), np.uint8)


class ColourSearch:
    """Back-projects the colours that the target has and its surroundings have not.

    A target whose colours are those of the background cannot be found this way: there are no
    candidates then.
    """

    def __init__(self) -> None:
        self._weights: npt.NDArray[np.float32] | None = None
        self._box = Box(0, 0, 1, 1)
        self._own = 0.0

    def learn(self, image: Image, box: Box) -> None:
        """Take the target's colours and the image's, (H, W, 3) uint8 BGR."""
        self._box = box
        target = colour_histogram(crop(image, box, _SIDE, _SIDE, _FILL))
        halvings = _halvings(image, box)
        factor = 0.5**halvings
        cells = _cells(_reduced(image, halvings))
        colours = _cell_bins().take(cells)
        around = np.bincount(colours.ravel(), minlength=len(target)) / colours.size
        likely = target / (target + around + 0.02)
        weights = likely.astype(np.float32).take(_cell_bins())
        density = self._density(cells, weights, factor)
        self._own = _at(density, box, factor)
        contrast = self._own / max(1e-6, float(density.mean()))
        self._weights = weights if contrast > _LEAST_CONTRAST and self._own > 0.1 else None

    def candidates(self, image: Image) -> list[Box]:
        """Return the places that have most of the colours, the best first, at the last size."""
        if self._weights is None:
            return []
        halvings = _halvings(image, self._box)
        factor = 0.5**halvings
        density = self._density(_cells(_reduced(image, halvings)), self._weights, factor)
        wide = max(1, round(self._box.width * factor))
        tall = max(1, round(self._box.height * factor))
        found = []
        for _ in range(_COLOUR_SEARCH_PEAKS):
            _, value, _, (x, y) = cv2.minMaxLoc(density)
            if value < _LEAST_SHARE_OF_OWN * self._own:
                break
            found.append(self._box.moved_to((x + 0.5) / factor, (y + 0.5) / factor))
            density[max(0, y - tall) : y + tall + 1, max(0, x - wide) : x + wide + 1] = 0
        return found

    def _density(
        self, cells: npt.NDArray[np.uint16], weights: npt.NDArray[np.float32], factor: float
    ) -> npt.NDArray[np.float32]:
        """Mean weight in a box of the target's size about every pixel of the reduced image."""
        likely = weights.take(cells)
        kernel = (
            max(1, round(self._box.width * factor)),
            max(1, round(self._box.height * factor)),
        )
        blurred = cv2.blur(likely, kernel, borderType=cv2.BORDER_CONSTANT)
        return np.asarray(blurred, np.float32)


def _halvings(image: Image, box: Box) -> int:
    """How often to halve: to few pixels, but a target keeps its least side as far as possible."""
    pixels = image.shape[0] * image.shape[1]
    few = math.sqrt(_MOST_PIXELS / pixels)
    enough = _LEAST_SIDE / min(box.width, box.height)
    bearable = math.sqrt(_MOST_PIXELS_SMALL_TARGET / pixels)
    return max(0, round(-math.log2(max(few, min(enough, bearable)))))


def _reduced(image: Image, halvings: int) -> Image:
    for _ in range(halvings):
        image = halved(image)
    return image


def _cells(image: Image) -> npt.NDArray[np.uint16]:
    """Number of each pixel's cell among 32 x 32 x 32 colours, (H, W)."""
    coarse = (image >> 3).astype(np.uint16)
    return np.asarray(coarse[..., 0] << 10 | coarse[..., 1] << 5 | coarse[..., 2])


@cache
def _cell_bins() -> npt.NDArray[np.intp]:
    """The colour histogram's bin of each of the 32768 cells."""
    cells = np.arange(1 << 15)
    colours = np.stack([cells >> 10, cells >> 5 & 31, cells & 31], axis=-1) * 8 + 4
    hsv = cv2.cvtColor(colours[None].astype(np.uint8), cv2.COLOR_BGR2HSV)
    return np.asarray(histogram_bins(np.asarray(hsv, np.uint8))[0])


def _at(density: npt.NDArray[np.float32], box: Box, factor: float) -> float:
    row = min(density.shape[0] - 1, max(0, int(box.cy * factor)))
    column = min(density.shape[1] - 1, max(0, int(box.cx * factor)))
    return float(density[row, column])
