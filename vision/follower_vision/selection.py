"""Finds a target in the pixels from a description of it: "the orange thing"."""

import math
import re
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image

_REFERENCE_LINES = 3
_LEAST_CONTRAST = 14.0
_FOREGROUND_SHARE = 0.4
Mask = npt.NDArray[np.uint8]
_GREY_SATURATION = 50
_MOST_COMPONENTS = 60
_LEAST_FILL = 0.25
_LEAST_PART = 0.08
_LARGE_PX = 3000
"""Of two things of the same colour the larger one is meant, until both are as large as this."""
_REACHES = (0.03, 0.045, 0.07, 0.1, 0.15, 0.22)
"""Half the side of the part looked at, as shares of the image's longer side."""
_LARGEST_PX = 640
"""Larger images are made smaller: a click is not to hold up vision."""
_INNER = 0.72
"""The ring of surroundings begins at this share of the reach."""
_BINS = 24
_RARE = 0.25
_LEAST_PX = 12
_LEAST_SIDE_PX = 3
_NEAR_PX = 4.0
_Rect = tuple[int, int, int, int]


def grown_to_contrast(image: Image, box: Box, max_growth_ratio: float) -> Box:
    """Return the box with each edge moved out over lines that differ from what lies beyond.

    A car's coloured body is surrounded by its dark wheels and windows; the road begins behind
    them. For each edge, the lines just beyond the largest growth stand for the surroundings, and
    the edge moves over those lines of which at least 40 % differ from them in Lab.

    Args:
        image: (H, W, 3) uint8 BGR.
        box: whole pixels are taken.
        max_growth_ratio: the furthest that an edge moves, as a share of the box's side.
    """
    x, y, w, h = (round(value) for value in box.xywh)
    across, down = round(w * max_growth_ratio), round(h * max_growth_ratio)
    margin = max(across, down) + _REFERENCE_LINES
    lab = _lab_around(image, (x, y, w, h), margin)
    if lab is None:
        return box
    columns = slice(margin, margin + w)
    rows = slice(margin, margin + h)
    top = _growth(lab[:margin, columns][::-1], down)
    bottom = _growth(lab[margin + h :, columns], down)
    left = _growth(lab[rows, :margin].swapaxes(0, 1)[::-1], across)
    right = _growth(lab[rows, margin + w :].swapaxes(0, 1), across)
    return Box.from_xywh(x - left, y - top, w + left + right, h + top + bottom)


def _lab_around(
    image: Image, whole: tuple[int, int, int, int], margin: int
) -> npt.NDArray[np.float32] | None:
    """The box and a margin in Lab; None where the margin leaves the image."""
    x, y, w, h = whole
    height, width = image.shape[:2]
    if x < margin or y < margin or x + w + margin > width or y + h + margin > height:
        return None
    patch = image[y - margin : y + h + margin, x - margin : x + w + margin]
    return cv2.cvtColor(patch, cv2.COLOR_BGR2Lab).astype(np.float32)


def _growth(lines: npt.NDArray[Any], most: int) -> int:
    """How many of the lines (nearest the box first) belong to the target, at most `most`."""
    if most < 1:
        return 0
    beyond = lines[most : most + _REFERENCE_LINES].reshape(-1, 3)
    middle = np.median(beyond, axis=0)
    spread = np.median(np.abs(beyond - middle).sum(axis=1))
    distance = np.abs(lines[:most] - middle).sum(axis=2)
    share = (distance > max(_LEAST_CONTRAST, 3 * spread)).mean(axis=1)
    differs = share >= _FOREGROUND_SHARE
    return int(most if differs.all() else np.argmin(differs))


@dataclass(frozen=True, slots=True)
class ColourSearchSettings:
    """How like the described colour a pixel and how big a target has to be.

    Hue and saturation hold in light and shade, brightness does not, so that the first two are
    strict and the last is lenient. Colours of little saturation (white, grey, black) are compared
    by brightness.

    Attributes:
        hue_tolerance_deg: largest difference of hue on the colour circle.
        saturation_ratio: least saturation, as a share of the described colour's.
        brightness_ratio: least brightness, as a share of the described colour's.
        grey_brightness_tolerance: for greys, the largest difference of brightness (of 255).
        min_area_px: least area of the target's box in square pixels.
        max_area_share: largest area of the target's box as a share of the image.
        merge_gap_ratio: parts of one target may be this far apart, as a share of their size.
        max_growth_ratio: how far each edge may move out to take in windows and wheels, as a share
            of the box's side; 0 leaves the box at the coloured part.
        max_candidates: how many boxes to return at most.
    """

    hue_tolerance_deg: float = 20.0
    saturation_ratio: float = 0.7
    brightness_ratio: float = 0.25
    grey_brightness_tolerance: float = 35.0
    min_area_px: float = 36.0
    max_area_share: float = 0.4
    merge_gap_ratio: float = 0.35
    max_growth_ratio: float = 0.2
    max_candidates: int = 8

    def __post_init__(self) -> None:
        if not 0 < self.hue_tolerance_deg <= 180:
            raise ValueError("hue_tolerance_deg lies between 0 and 180")
        if self.min_area_px <= 0 or self.max_candidates < 1:
            raise ValueError("min_area_px and max_candidates have to be positive")
        if not 0 < self.max_area_share <= 1:
            raise ValueError("max_area_share lies between 0 and 1")
        shares = (self.saturation_ratio, self.brightness_ratio, self.max_growth_ratio)
        if not all(0 <= share <= 1 for share in shares) or self.merge_gap_ratio < 0:
            raise ValueError("the ratios lie between 0 and 1")


def colour_from_hex(text: str) -> tuple[int, int, int]:
    """Return (blue, green, red) of a colour written as "#rrggbb" or "rrggbb".

    Raises:
        ValueError: the text is not of that form.
    """
    if not re.fullmatch(r"#?[0-9a-fA-F]{6}", text):
        raise ValueError(f"a colour is written #rrggbb, such as #ff5a1e, not {text!r}")
    red, green, blue = bytes.fromhex(text.removeprefix("#"))
    return blue, green, red


def find_by_colour(
    image: Image,
    colour_bgr: tuple[int, int, int],
    settings: ColourSearchSettings = ColourSearchSettings(),
) -> list[Box]:
    """Return the boxes of what has the colour, the likeliest first; empty if nothing has.

    Args:
        image: (H, W, 3) uint8 BGR.
        colour_bgr: (blue, green, red), 0 to 255, as the target appears in good light.
        settings: what is alike and what is too small.
    """
    mask = np.asarray(cv2.medianBlur(colour_mask(image, colour_bgr, settings), 3), np.uint8)
    parts = _components(mask)
    largest = settings.max_area_share * image.shape[0] * image.shape[1]
    boxes = [
        box
        for box in _merged(parts, settings.merge_gap_ratio)
        if settings.min_area_px <= box.area <= largest
    ]
    reference = _hsv(colour_bgr)
    ranked = sorted(boxes, key=lambda box: _score(image, mask, box, reference), reverse=True)
    best = ranked[: settings.max_candidates]
    grown = [grown_to_contrast(image, box, settings.max_growth_ratio) for box in best]
    return [box for box in grown if not any(_is_part(box, other) for other in grown)]


def colour_mask(
    image: Image, colour_bgr: tuple[int, int, int], settings: ColourSearchSettings
) -> Mask:
    """Return (H, W) uint8: 255 where a pixel is like the colour, else 0."""
    hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
    hue, saturation, value = _hsv(colour_bgr)
    if saturation < _GREY_SATURATION:
        near = settings.grey_brightness_tolerance
        return _in_range(hsv, (0, 0, value - near), (180, _GREY_SATURATION, value + near))
    floor = (settings.saturation_ratio * saturation, settings.brightness_ratio * value)
    reach = settings.hue_tolerance_deg / 2
    mask = _in_range(hsv, (hue - reach, *floor), (hue + reach, 255, 255))
    if hue < reach:
        mask |= _in_range(hsv, (hue - reach + 180, *floor), (180, 255, 255))
    if hue + reach > 180:
        mask |= _in_range(hsv, (0, *floor), (hue + reach - 180, 255, 255))
    return mask


def _hsv(colour_bgr: tuple[int, int, int]) -> tuple[float, float, float]:
    pixel = cv2.cvtColor(np.array([[colour_bgr]], np.uint8), cv2.COLOR_BGR2HSV)[0, 0]
    return float(pixel[0]), float(pixel[1]), float(pixel[2])


def _in_range(
    hsv: npt.NDArray[Any], low: tuple[float, float, float], high: tuple[float, float, float]
) -> Mask:
    return np.asarray(cv2.inRange(hsv, np.array(low, float), np.array(high, float)), np.uint8)


def _components(mask: Mask) -> list[Box]:
    """Boxes of the dense connected parts of a mask, the largest first."""
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    rows = sorted(stats[1:].tolist(), key=lambda row: -row[cv2.CC_STAT_AREA])
    boxes = [(Box.from_xywh(*row[:4]), row[cv2.CC_STAT_AREA]) for row in rows[:_MOST_COMPONENTS]]
    return [box for box, count in boxes if count >= max(4, _LEAST_FILL * box.area)]


def _merged(boxes: list[Box], gap_ratio: float) -> list[Box]:
    """Join boxes that lie near each other; what is much smaller is no part but another thing."""
    joined: list[Box] = []
    for box in boxes:
        current = box
        while (near := _first_near(current, joined, gap_ratio)) is not None:
            joined.remove(near)
            current = _hull(current, near)
        joined.append(current)
    return joined


def _first_near(box: Box, others: list[Box], gap_ratio: float) -> Box | None:
    for other in others:
        if min(box.area, other.area) < _LEAST_PART * max(box.area, other.area):
            continue
        reach = gap_ratio * max(box.scale, other.scale)
        across = max(box.left, other.left) - min(box.right, other.right)
        down = max(box.top, other.top) - min(box.bottom, other.bottom)
        if max(across, down) <= reach:
            return other
    return None


def _hull(one: Box, two: Box) -> Box:
    left, top = min(one.left, two.left), min(one.top, two.top)
    right, bottom = max(one.right, two.right), max(one.bottom, two.bottom)
    return Box.from_xywh(left, top, right - left, bottom - top)


def _is_part(box: Box, other: Box) -> bool:
    """Whether a box lies mostly upon a larger one, as a boat's roof upon what its hull spans."""
    return box.area < other.area and box.intersection(other) > box.area / 2


def _score(image: Image, mask: Mask, box: Box, reference: tuple[float, float, float]) -> float:
    """How well a box's coloured pixels agree with the colour, fill the box and are many."""
    x, y, w, h = (round(value) for value in box.xywh)
    inside = mask[y : y + h, x : x + w]
    count = cv2.countNonZero(inside)
    mean = cv2.mean(image[y : y + h, x : x + w], inside)[:3]
    hue, saturation, _ = _hsv((round(mean[0]), round(mean[1]), round(mean[2])))
    turn = abs((hue - reference[0] + 90) % 180 - 90) / 20
    paler = abs(saturation - reference[1]) / 80
    off = paler**2 + (turn**2 if reference[1] >= _GREY_SATURATION else 0.0)
    return math.exp(-off) * (count / box.area) * math.sqrt(min(1.0, count / _LARGE_PX))


def box_around(image: Image, x: float, y: float) -> Box | None:
    """Return the box of what stands out from its surroundings at a point, None if nothing does.

    In ever larger squares about the point, the pixels whose colour is rare in the ring at the
    square's border are taken for the thing, and what is connected under the point is its extent.
    The largest square counts in which that does not reach the ring: in smaller ones it may be a
    part, such as a shirt. Within a large thing the ring has its own colours, and on open ground
    nothing is rare.

    Args:
        image: (H, W, 3) uint8 BGR.
        x: of the point, in pixels.
        y: likewise.
    """
    zoom = min(1.0, _LARGEST_PX / max(image.shape[:2]))
    small = cv2.resize(image, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_AREA)
    lab = cv2.cvtColor(small, cv2.COLOR_BGR2Lab)
    place = int(x * zoom), int(y * zoom)
    sides = (max(round(reach * max(small.shape[:2])), 8) for reach in _REACHES)
    found = [rect for side in sides if (rect := _within(lab, *place, side)) is not None]
    return Box.from_xywh(*(length / zoom for length in found[-1])) if found else None


def _within(lab: npt.NDArray[Any], x: int, y: int, side: int) -> _Rect | None:
    height, width = lab.shape[:2]
    left, right = max(x - side, 0), min(x + side + 1, width)
    top, bottom = max(y - side, 0), min(y + side + 1, height)
    part = lab[top:bottom, left:right]
    if min(part.shape[:2]) < _LEAST_SIDE_PX:
        return None
    rows = np.abs(np.arange(top, bottom) - y)[:, None]
    columns = np.abs(np.arange(left, right) - x)[None, :]
    ring = np.maximum(rows, columns) > _INNER * side
    rect = _under(_rare(part, ring), ring, x - left, y - top)
    return None if rect is None else (rect[0] + left, rect[1] + top, rect[2], rect[3])


def _rare(part: npt.NDArray[Any], ring: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    """Return 1 where a pixel's colour is rare in the ring, else 0."""
    bins = (part.astype(np.int32) * _BINS) >> 8
    # Light and shade matter less than colour.
    index = (bins[..., 0] // 2 * _BINS + bins[..., 1]) * _BINS + bins[..., 2]
    counts = np.bincount(index[ring], minlength=_BINS**3 // 2).astype(np.float32)
    cube = counts.reshape(_BINS // 2, _BINS, _BINS)
    for axis in range(3):
        cube = cube + np.roll(cube, 1, axis) + np.roll(cube, -1, axis)
    density = cube.ravel()[index]
    usual = float(np.median(density[ring]))
    mask = np.asarray(density < _RARE * usual, np.uint8)
    kernel = np.ones((3, 3), np.uint8)
    closed = cv2.morphologyEx(cv2.medianBlur(mask, 3), cv2.MORPH_CLOSE, kernel)
    return np.asarray(closed, np.uint8)


def _under(mask: npt.NDArray[np.uint8], ring: npt.NDArray[Any], x: int, y: int) -> _Rect | None:
    """Return the box of the component at a point, or just beside it, unless it is in the ring."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    rows, columns = np.nonzero(labels)
    if not len(rows):
        return None
    distances = np.hypot(rows - y, columns - x)
    nearest = int(np.argmin(distances))
    if distances[nearest] > _NEAR_PX:
        return None
    label = labels[rows[nearest], columns[nearest]]
    left, top, across, down, area = (int(value) for value in stats[label])
    too_small = area < _LEAST_PX or min(across, down) < _LEAST_SIDE_PX
    if too_small or np.any(ring[labels == label]):
        return None
    return left, top, across, down
