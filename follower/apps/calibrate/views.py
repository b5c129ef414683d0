"""Chooses, of all images that show the board, those that teach something new."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from follower.apps.calibrate.board import Board, Points, SeenBoard
from follower_control.common.strict_config import SettingsError
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.images.frame import Image

_Grey: TypeAlias = npt.NDArray[np.float32]

_STEP_PX, _MOST_SAMPLES = 0.5, 201
_REACH = 0.45
"""Of a square's side, to either side of an edge."""


def blur_px(board: Board, seen: SeenBoard, image: Image) -> float:
    """Return over how many pixels the edges between squares go from black to white.

    Across the middle of each edge: the contrast over the steepest slope. The median of the edges;
    about 1.5 for a sharp image, infinity if no edge has both ends in view.
    """
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.float32)
    places = {int(one): seen.image_px[row] for row, one in enumerate(seen.ids)}
    widths = [
        _width_px(grey, places[one], places[other])
        for one in places
        for other in _neighbours(board, one)
        if other in places
    ]
    return float(np.median(widths)) if widths else math.inf


def _neighbours(board: Board, corner: int) -> list[int]:
    columns = board.across - 1
    right = [corner + 1] if (corner + 1) % columns else []
    return [*right, corner + columns]


def _width_px(grey: _Grey, one: Points, other: Points) -> float:
    """Return the width of the edge between two corners."""
    along = other - one
    across = np.array([-along[1], along[0]])
    reach_px = float(np.hypot(*across)) * _REACH
    samples = min(_MOST_SAMPLES, 2 * math.ceil(reach_px / _STEP_PX) + 3)
    steps = np.linspace(-_REACH, _REACH, samples)[:, None]
    places = ((one + other) / 2 + steps * across - 0.5).astype(np.float32)
    x, y = places[:, :1], places[:, 1:]
    values = cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    profile = np.asarray(values, np.float64).reshape(-1)
    steepest = float(np.abs(np.diff(profile)).max()) * (samples - 1) / (2 * reach_px)
    return float(np.ptp(profile)) / steepest if steepest > 0 else math.inf


MOST_VIEWS = 40
"""More take minutes to compute on a small computer and say nothing new."""
_GUESSED_FOV_RAD = math.radians(70.0)
_NEW_PLACE, _NEW_SIZE, _NEW_TILT = 0.07, 0.12, math.radians(9.0)
_BLURRED_PX, _BLURRED_SHARE = 4.5, 1 / 250


@dataclass(frozen=True, slots=True)
class BoardView:
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

    def differs_from(self, other: BoardView) -> bool:
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
    views: list[BoardView] = field(default_factory=list)
    images: int = 0
    without_board: int = 0
    blurred: int = 0
    known: int = 0
    sample: Image | None = None
    _largest: float = 0.0

    @property
    def full(self) -> bool:
        """Whether there are as many as are computed with."""
        return len(self.views) >= MOST_VIEWS

    def add(self, image: Image) -> SeenBoard | None:
        """Look at an image; return the board if it is in it.

        Raises:
            SettingsError: it has another size than those before.
        """
        size = (image.shape[1], image.shape[0])
        if self.size is not None and self.size != size:
            raise SettingsError(
                "image {} has {} x {} pixels, those before it {} x {}: a lens is calibrated for "
                "one size".format(self.images + 1, *size, *self.size)
            )
        self.size = size
        self.images += 1
        seen = self.board.find(image)
        if seen is None:
            self.without_board += 1
        elif blur_px(self.board, seen, image) > max(_BLURRED_PX, _BLURRED_SHARE * size[0]):
            self.blurred += 1
        else:
            self._keep(BoardView(seen, self.images - 1, pose_of(seen, size)), image)
        return seen

    def _keep(self, view: BoardView, image: Image) -> None:
        if not all(view.differs_from(other) for other in self.views):
            self.known += 1
            return
        self.views.append(view)
        if view.pose[2] > self._largest:
            self._largest, self.sample = view.pose[2], image.copy()


def spread(views: Sequence[BoardView]) -> list[BoardView]:
    """Return at most `MOST_VIEWS` of them, those that differ most, in their order."""
    poses = np.array([view.pose for view in views]).reshape(-1, 5)
    poses[:, 2] = np.log(poses[:, 2])
    poses /= (_NEW_PLACE, _NEW_PLACE, _NEW_SIZE, _NEW_TILT, _NEW_TILT)
    chosen, away = list[int](), np.full(len(views), math.inf)
    while len(chosen) < min(MOST_VIEWS, len(views)):
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(poses - poses[chosen[-1]], axis=1))
    return [views[number] for number in sorted(chosen)]


def pose_of(seen: SeenBoard, size: tuple[int, int]) -> tuple[float, float, float, float, float]:
    """Return place, size and tilt of a board; see `View.pose`."""
    width, height = size
    x, y = seen.image_px.mean(0) / (width, height)
    spread = float(np.ptp(seen.image_px, 0).max()) / width
    lens = CameraModel.from_fov(width, height, _GUESSED_FOV_RAD)
    _, turn, _ = cv2.solvePnP(
        seen.board_m, seen.image_px, lens.matrix, None, flags=cv2.SOLVEPNP_IPPE
    )
    normal: npt.NDArray[np.float64] = np.asarray(cv2.Rodrigues(turn)[0], np.float64)[:, 2]
    away = normal if normal[2] >= 0 else -normal  # in the camera's frame, away from the camera
    return float(x), float(y), max(spread, 1e-3), float(away[0]), float(away[1])
