"""An axis-aligned box in an image."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

Floats: TypeAlias = npt.NDArray[np.floating]


@dataclass(frozen=True, slots=True)
class Box:
    """Centre and size in pixels: x right, y down, origin at the corner of the top-left pixel.

    Boxes are real-valued and may reach beyond the image.

    Raises:
        ValueError: a value is not finite, or a side is not positive, or the area rounds to 0.

    Examples:
        >>> import follower
        >>> box = follower.Box.from_xywh(300, 200, 40, 20)
        >>> box.cx, box.cy, box.iou(follower.Box(320, 210, 40, 20))
        (320.0, 210.0, 1.0)
    """

    cx: float
    """x of the centre, in pixels."""
    cy: float
    """y of the centre, in pixels."""
    width: float
    """In pixels, positive."""
    height: float
    """In pixels, positive."""

    def __post_init__(self) -> None:
        if not all(map(math.isfinite, (self.cx, self.cy, self.width, self.height))):
            raise ValueError(f"a box needs finite numbers, not {self}")
        if self.width <= 0 or self.height <= 0 or self.area == 0:  # 1e-200 px squared is 0
            raise ValueError(f"a box needs a positive width and height, not {self}")

    @classmethod
    def from_xywh(cls, x: float, y: float, width: float, height: float) -> Box:
        """Make a box from its top-left corner and size in pixels, the form of most data sets."""
        return cls(x + width / 2, y + height / 2, width, height)

    @property
    def left(self) -> float:
        """The left edge's x."""
        return self.cx - self.width / 2

    @property
    def top(self) -> float:
        """The top edge's y."""
        return self.cy - self.height / 2

    @property
    def right(self) -> float:
        """The right edge's x."""
        return self.cx + self.width / 2

    @property
    def bottom(self) -> float:
        """The bottom edge's y."""
        return self.cy + self.height / 2

    @property
    def xywh(self) -> tuple[float, float, float, float]:
        """Top-left corner and size in pixels: (x, y, width, height)."""
        return self.left, self.top, self.width, self.height

    @property
    def area(self) -> float:
        """Area in square pixels."""
        return self.width * self.height

    @property
    def scale(self) -> float:
        """Side of the square of equal area, in pixels."""
        return math.sqrt(self.area)

    def moved_to(self, cx: float, cy: float) -> Box:
        """Return a box of the same size about another centre, in pixels."""
        return Box(cx, cy, self.width, self.height)

    def scaled(self, factor: float) -> Box:
        """Return a box about the same centre in pixels, both sides multiplied by `factor`."""
        return Box(self.cx, self.cy, self.width * factor, self.height * factor)

    def intersection(self, other: Box) -> float:
        """Return the area that both boxes cover, in square pixels."""
        across = min(self.right, other.right) - max(self.left, other.left)
        down = min(self.bottom, other.bottom) - max(self.top, other.top)
        return max(0.0, across) * max(0.0, down)

    def iou(self, other: Box) -> float:
        """Return intersection over union, 0 to 1."""
        inter = self.intersection(other)
        return inter / (self.area + other.area - inter)

    def distance(self, other: Box) -> float:
        """Return the distance between the centres in pixels."""
        return math.hypot(self.cx - other.cx, self.cy - other.cy)

    def visible_share(self, image_width: int, image_height: int) -> float:
        """Return the share of the box's area that lies inside the image, 0 to 1."""
        image = Box(image_width / 2, image_height / 2, image_width, image_height)
        return self.intersection(image) / self.area

    def clipped(self, image_width: int, image_height: int) -> Box | None:
        """Return the part that lies inside the image, None if nothing does."""
        left, right = max(self.left, 0.0), min(self.right, float(image_width))
        top, bottom = max(self.top, 0.0), min(self.bottom, float(image_height))
        if left >= right or top >= bottom:
            return None
        if (left, top, right, bottom) == (self.left, self.top, self.right, self.bottom):
            return self
        return Box((left + right) / 2, (top + bottom) / 2, right - left, bottom - top)


def lies_in(box: Box, region: Box | None, margin_px: float = 0.0) -> bool:
    """Return whether a box has its centre in a region, or beside it by no more than a margin.

    Everything lies in the region None.
    """
    if region is None:
        return True
    right, down = abs(box.cx - region.cx), abs(box.cy - region.cy)
    return right <= region.width / 2 + margin_px and down <= region.height / 2 + margin_px


def pairwise_iou(corners: Floats, others: Floats) -> Floats:
    """Return the intersection over union of every box with every other, (N, M).

    Both arguments hold left, top, right, bottom in their rows: (N, 4) and (M, 4).
    """
    first, second = corners[:, None, :], others[None, :, :]
    low = np.maximum(first[..., :2], second[..., :2])
    high = np.minimum(first[..., 2:], second[..., 2:])
    common = np.maximum(high - low, 0.0)
    sides, other_sides = first[..., 2:] - first[..., :2], second[..., 2:] - second[..., :2]
    # Written out: for two factors numpy's product takes several times as long.
    intersection = common[..., 0] * common[..., 1]
    areas, other_areas = sides[..., 0] * sides[..., 1], other_sides[..., 0] * other_sides[..., 1]
    union = areas + other_areas - intersection
    return np.asarray(np.divide(intersection, union, out=np.zeros_like(union), where=union > 0))


def keep_best(corners: Floats, scores: Floats, overlap: float, most: int) -> list[int]:
    """Return the indices of at most `most` boxes, best first, no two overlapping too much.

    Args:
        corners: (N, 4) left, top, right, bottom.
        scores: (N,), above 0.
        overlap: largest intersection over union that two kept boxes may have.
        most: how many to keep.
    """
    sides = corners[:, 2:] - corners[:, :2]
    boxes = np.hstack([corners[:, :2], sides]).tolist()
    return [int(index) for index in cv2.dnn.NMSBoxes(boxes, scores.tolist(), 0.0, overlap)[:most]]
