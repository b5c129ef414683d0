"""Finds a target in the pixels from a description of it: "the orange thing"."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any, ClassVar

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.box import Box
from follower_vision.boxgrowth import grown_to_contrast
from follower_vision.frame import Image

Mask = npt.NDArray[np.uint8]
_GREY_SATURATION = 50
_MOST_COMPONENTS = 60
_LEAST_FILL = 0.25
_LEAST_PART = 0.08
_LARGE_PX = 3000
"""Of two things of the same colour the larger one is meant, until both are as large as this."""


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

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

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
        colour_bgr: (blue, green, red), 0 to 255, as the target looks in good light.
        settings: what is alike and what is too small.
    """
    mask = _without_specks(colour_mask(image, colour_bgr, settings))
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


def _without_specks(mask: Mask) -> Mask:
    """Noise makes single pixels of any colour; a target is denser than that."""
    return np.asarray(cv2.medianBlur(mask, 3), np.uint8)


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
