"""A picture of a calibration: where the board was seen, and an image without its distortion."""

from __future__ import annotations

import cv2
import numpy as np

from follower.calibration.coverage import COLUMNS, ROWS, Coverage
from follower.calibration.solving import Calibration
from follower.calibration.views import View
from follower_vision.camera import CameraModel
from follower_vision.frame import Image

_WIDTH = 640
_DARK, _GREEN, _WHITE, _AMBER = (38, 32, 28), (96, 150, 60), (240, 240, 240), (60, 170, 250)
_BAR = 34


def picture(calibration: Calibration, sample: Image) -> Image:
    """Return coverage on the left, an undistorted image on the right."""
    lens = calibration.lens
    height = round(_WIDTH * lens.height / lens.width)
    coverage = Coverage(calibration.views, (lens.width, lens.height))
    left = _coverage(calibration.views, coverage, lens, height)
    right = cv2.resize(undistorted(sample, lens), (_WIDTH, height), interpolation=cv2.INTER_AREA)
    titles = (
        f"{len(calibration.views)} views, {coverage.share:.0%} of the image, "
        f"{calibration.error_px:.2f} px off",
        f"without distortion: edges must be straight; focal length {lens.fx:.1f} px",
    )
    panels = [
        np.vstack([_title(text), np.asarray(image, np.uint8)])
        for text, image in zip(titles, (left, right), strict=True)
    ]
    return np.hstack(panels)


def undistorted(image: Image, lens: CameraModel) -> Image:
    """Return the image as a lens without distortion, and with its axis in the middle, sees it."""
    straight = CameraModel.from_fov(lens.width, lens.height, lens.horizontal_fov_rad)
    x, y = np.meshgrid(np.arange(lens.width) + 0.5, np.arange(lens.height) + 0.5)
    rays = straight.rays(np.stack([x, y], -1))
    where = (lens.pixels(rays) - 0.5).astype(np.float32).reshape(lens.height, lens.width, 2)
    straightened = cv2.remap(image, where[..., 0], where[..., 1], cv2.INTER_LINEAR)
    return np.asarray(straightened, np.uint8)


def _coverage(views: tuple[View, ...], coverage: Coverage, lens: CameraModel, height: int) -> Image:
    drawn = np.full((height, _WIDTH, 3), _DARK, np.uint8)
    for row, column in np.argwhere(coverage.covered):
        corner = (column * _WIDTH // COLUMNS + 2, row * height // ROWS + 2)
        other = ((column + 1) * _WIDTH // COLUMNS - 2, (row + 1) * height // ROWS - 2)
        cv2.rectangle(drawn, corner, other, _GREEN, -1)
    for view in views:
        for x, y in view.seen.image_px * (_WIDTH / lens.width):
            cv2.circle(drawn, (int(x), int(y)), 2, _WHITE, -1, cv2.LINE_AA)
    for name in coverage.missing():
        _say_missing(drawn, name)
    return drawn


def _say_missing(drawn: Image, name: str) -> None:
    """Write into a ninth of the image that it is empty."""
    height, width = drawn.shape[:2]
    words = name.split() if " " in name else ["middle", "middle"]
    row = ("top", "middle", "bottom").index(words[0])
    column = ("left", "middle", "right").index(words[1])
    at = (column * width // 3 + 12, (2 * row + 1) * height // 6)
    cv2.putText(drawn, "too few", at, cv2.FONT_HERSHEY_SIMPLEX, 0.7, _AMBER, 2, cv2.LINE_AA)


def _title(text: str) -> Image:
    bar = np.full((_BAR, _WIDTH, 3), _DARK, np.uint8)
    cv2.putText(bar, text, (8, 23), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _WHITE, 1, cv2.LINE_AA)
    return bar
