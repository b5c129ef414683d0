"""Chooses, of all images that show the board, those that teach something new."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt

from follower.calibration.board import Board, SeenBoard
from follower.calibration.sharpness import blur_px
from follower_vision.camera import CameraModel
from follower_vision.frame import Image

MOST_VIEWS = 40
"""More take minutes to compute on a small computer and say nothing new."""
_GUESSED_FOV_RAD = math.radians(70.0)
_NEW_PLACE, _NEW_SIZE, _NEW_TILT = 0.07, 0.12, math.radians(9.0)
_BLURRED_PX, _BLURRED_SHARE = 4.5, 1 / 250


@dataclass(frozen=True, slots=True)
class View:
    """One image of the board.

    Attributes:
        seen: its corners.
        number: of the image, counted from 0.
        pose: (x, y, size) of the board as shares of the image, and its normal's x and y; by a
            guessed lens, to tell views apart.
    """

    seen: SeenBoard
    number: int
    pose: tuple[float, float, float, float, float]

    def differs_from(self, other: View) -> bool:
        """Whether it shows the board somewhere else, nearer, farther, or tilted otherwise."""
        x, y, size, *normal = self.pose
        x2, y2, size2, *normal2 = other.pose
        moved = math.hypot(x - x2, y - y2) > _NEW_PLACE
        scaled = abs(math.log(size / size2)) > _NEW_SIZE
        return moved or scaled or math.dist(normal, normal2) > _NEW_TILT

    @property
    def tilt_deg(self) -> float:
        """How far the board is turned away from facing the camera."""
        return math.degrees(math.asin(min(1.0, math.hypot(*self.pose[3:]))))


@dataclass(slots=True)
class ViewCollection:
    """Takes images one by one, and keeps the views that are sharp and new.

    Attributes:
        board: to look for.
        size: width and height of the images, None before the first.
        views: that were kept.
        images: looked at.
        without_board: of these, such as did not show it.
        blurred: of these, such as showed it blurred.
        known: of these, such as showed it where it had been.
        sample: the kept image that shows the board largest.
    """

    board: Board
    size: tuple[int, int] | None = None
    views: list[View] = field(default_factory=list)
    images: int = 0
    without_board: int = 0
    blurred: int = 0
    known: int = 0
    sample: Image | None = None
    _largest: float = 0.0

    @property
    def full(self) -> bool:
        """Whether no more are wanted."""
        return len(self.views) >= MOST_VIEWS

    def add(self, image: Image) -> SeenBoard | None:
        """Look at an image; return the board if it is in it.

        Raises:
            ValueError: it has another size than those before.
        """
        size = (image.shape[1], image.shape[0])
        if self.size not in (None, size):
            raise ValueError(
                f"image {self.images + 1} has {size[0]} x {size[1]} pixels, those before it "
                f"{self.size}: a lens is calibrated for one size"
            )
        self.size = size
        self.images += 1
        seen = self.board.find(image)
        if seen is None:
            self.without_board += 1
        elif blur_px(self.board, seen, image) > max(_BLURRED_PX, _BLURRED_SHARE * size[0]):
            self.blurred += 1
        else:
            self._keep(View(seen, self.images - 1, pose_of(seen, size)), image)
        return seen

    def _keep(self, view: View, image: Image) -> None:
        if self.full or not all(view.differs_from(other) for other in self.views):
            self.known += 1
            return
        self.views.append(view)
        if view.pose[2] > self._largest:
            self._largest, self.sample = view.pose[2], image.copy()


def pose_of(seen: SeenBoard, size: tuple[int, int]) -> tuple[float, float, float, float, float]:
    """Return place, size and tilt of a board; see `View.pose`."""
    width, height = size
    x, y = seen.image_px.mean(0) / (width, height)
    spread = float(np.ptp(seen.image_px, 0).max()) / width
    normal = _normal(seen, CameraModel.from_fov(width, height, _GUESSED_FOV_RAD))
    return float(x), float(y), max(spread, 1e-3), float(normal[0]), float(normal[1])


def _normal(seen: SeenBoard, lens: CameraModel) -> npt.NDArray[np.float64]:
    """Return the board's normal in the camera frame, pointing away from the camera."""
    _, turn, _ = cv2.solvePnP(
        seen.board_m, seen.image_px, lens.matrix, None, flags=cv2.SOLVEPNP_IPPE
    )
    normal: npt.NDArray[np.float64] = np.asarray(cv2.Rodrigues(turn)[0], np.float64)[:, 2]
    return normal if normal[2] >= 0 else -normal
