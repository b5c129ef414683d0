"""An object cut out of a picture: its colours, its mask and the outline of the mask."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.box import Box

Matrix: TypeAlias = npt.NDArray[np.float64]

_SOLID = 127
_LEAST_LEVEL_PX = 12


@dataclass(frozen=True, slots=True, eq=False)
class Cutout:
    """A flat object with a soft mask.

    Attributes:
        levels: (H, W, 4) uint8 blue, green, red (multiplied by the mask) and mask; each level has
            half the side of the one before it.
        outline: (K, 2) corners of the mask's convex hull in the first level's pixels, from the
            corner of its top-left pixel.
    """

    levels: tuple[npt.NDArray[np.uint8], ...]
    outline: Matrix

    @classmethod
    def of(cls, picture: npt.NDArray[np.uint8]) -> Cutout:
        """Make a cut-out of (H, W, 4) uint8 with colours not yet multiplied by the mask.

        Raises:
            ValueError: nothing of it is solid.
        """
        return cls.premultiplied(_premultiplied(picture))

    @classmethod
    def premultiplied(cls, picture: npt.NDArray[np.uint8]) -> Cutout:
        """Make a cut-out of (H, W, 4) uint8 whose colours are multiplied by the mask.

        Raises:
            ValueError: nothing of it is solid.
        """
        levels = [picture]
        while min(levels[-1].shape[:2]) >= 2 * _LEAST_LEVEL_PX:
            height, width = levels[-1].shape[:2]
            smaller = cv2.resize(
                levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA
            )
            levels.append(np.asarray(smaller, dtype=np.uint8))
        return cls(tuple(levels), mask_outline(picture[:, :, 3]))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the first level in pixels."""
        height, width = self.levels[0].shape[:2]
        return width, height

    def box(self, placement: Matrix) -> Box:
        """Return the box about the mask where `placement`, (3, 3), puts it in the frame."""
        points = self.outline @ placement[:, :2].T + placement[:, 2]
        points = points[:, :2] / points[:, 2:]
        left, top = points.min(axis=0)
        right, bottom = points.max(axis=0)
        return Box.from_xywh(left, top, right - left, bottom - top)

    def draw(
        self, canvas: npt.NDArray[np.uint8], placement: Matrix
    ) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
        """Return the canvas (H, W, 3) with the object on it, and the object's mask (H, W).

        Args:
            canvas: what lies behind; it is left as it is.
            placement: (3, 3) from the cut-out's pixels to the canvas's, corner to corner.
        """
        height, width = canvas.shape[:2]
        level, matrix = self._level(placement)
        warped = warp(level, matrix, width, height, cv2.BORDER_CONSTANT)
        mask = np.ascontiguousarray(warped[:, :, 3])
        if not mask.any():
            return canvas, mask
        behind = cv2.multiply(canvas, cv2.merge([255 - mask] * 3), scale=1 / 255)
        return np.asarray(cv2.add(behind, warped[:, :, :3]), dtype=np.uint8), mask

    def _level(self, placement: Matrix) -> tuple[npt.NDArray[np.uint8], Matrix]:
        (a, b), (c, d) = placement[:2, :2].tolist()
        scale = math.sqrt(abs(a * d - b * c)) / abs(placement[2, 2])
        wanted = math.floor(-math.log2(max(scale, 1e-6)))
        level = self.levels[min(max(wanted, 0), len(self.levels) - 1)]
        width, height = self.size
        enlarge = np.diag([width / level.shape[1], height / level.shape[0], 1.0])
        return level, placement @ enlarge


def warp(
    picture: npt.NDArray[np.uint8], placement: Matrix, width: int, height: int, border: int
) -> npt.NDArray[np.uint8]:
    """Return a picture as `placement`, (3, 3), puts it on a canvas; corners go to corners."""
    half = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    back = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])
    matrix = back @ placement @ half
    if matrix[2, 0] == 0.0 and matrix[2, 1] == 0.0:
        affine = matrix[:2] / matrix[2, 2]
        out = cv2.warpAffine(
            picture, affine, (width, height), flags=cv2.INTER_LINEAR, borderMode=border
        )
    else:
        out = cv2.warpPerspective(
            picture, matrix, (width, height), flags=cv2.INTER_LINEAR, borderMode=border
        )
    return np.asarray(out, dtype=np.uint8)


def mask_outline(mask: npt.NDArray[np.uint8]) -> Matrix:
    """Return the convex hull (K, 2) of a mask's solid pixels, corners included.

    Raises:
        ValueError: no pixel is solid.
    """
    _, solid = cv2.threshold(mask, _SOLID, 255, cv2.THRESH_BINARY)
    edges, _ = cv2.findContours(solid, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    if not edges:
        raise ValueError("a cut-out needs a solid part")
    hull = cv2.convexHull(np.concatenate(edges)).reshape(-1, 2).astype(np.float64)
    corners = [hull + step for step in ((0, 0), (1, 0), (0, 1), (1, 1))]
    return np.concatenate(corners)


def _premultiplied(picture: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    mask = picture[:, :, 3]
    colours = cv2.multiply(picture[:, :, :3], cv2.merge([mask] * 3), scale=1 / 255)
    return np.dstack([colours, mask]).astype(np.uint8)
