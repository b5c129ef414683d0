"""Measures how the camera moved, by the background's corners."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.box import Box
from follower_vision.frame import Image
from follower_vision.fusion.warp import Warp

_WIDTH = 320
_CORNERS = 80
_QUALITY = 0.01
_APART = 7
_WINDOW = (11, 11)
_LEVELS = 3
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)
_OUTLIER_PX = 1.0
_LEAST_INLIERS = 12
_LEAST_INLIER_SHARE = 0.4
_MOST_ZOOM = 1.2
_AROUND_TARGET = 1.3


class CameraMotion:
    """Sparse optical flow (Lucas and Kanade) on a small grey image, then a robust similarity.

    Where too little of the background agrees, the motion is said to be none.
    """

    def __init__(self) -> None:
        self._grey: npt.NDArray[np.uint8] | None = None
        self._image: Image | None = None
        self._warp = Warp()

    def reset(self) -> None:
        """Forget the last image."""
        self._grey = self._image = None

    def update(self, image: Image, avoid: Sequence[Box] = ()) -> Warp:
        """Return the motion from the last image to this one, (H, W, 3) uint8 BGR.

        Asked again for the same image object, it answers the same without working.

        Args:
            image: the next image.
            avoid: boxes in the last image that move by themselves.
        """
        if image is self._image:
            return self._warp
        factor = min(1.0, _WIDTH / image.shape[1])
        grey = _reduced(image, factor)
        last, self._grey, self._image = self._grey, grey, image
        if last is None or last.shape != grey.shape:
            self._warp = Warp()
        else:
            self._warp = _motion(last, grey, [box.scaled(_AROUND_TARGET) for box in avoid], factor)
        return self._warp


def _reduced(image: Image, factor: float) -> npt.NDArray[np.uint8]:
    """The image in grey, halved by the mean of four pixels as often as possible: that is fast."""
    small = image
    while factor < 1 and small.shape[1] * 0.5 >= image.shape[1] * factor:
        half = (small.shape[1] // 2, small.shape[0] // 2)
        small = np.asarray(cv2.resize(small, half, interpolation=cv2.INTER_LINEAR), np.uint8)
    size = (round(image.shape[1] * factor), round(image.shape[0] * factor))
    if (small.shape[1], small.shape[0]) != size:
        small = np.asarray(cv2.resize(small, size, interpolation=cv2.INTER_AREA), np.uint8)
    return np.asarray(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), np.uint8)


def _motion(
    last: npt.NDArray[np.uint8], grey: npt.NDArray[np.uint8], avoid: list[Box], factor: float
) -> Warp:
    corners: Any = cv2.goodFeaturesToTrack(last, _CORNERS, _QUALITY, _APART)
    if corners is None:
        return Warp()
    corners = _outside(corners.reshape(-1, 2), avoid, factor)
    if len(corners) < _LEAST_INLIERS:
        return Warp()
    points: Any = corners.reshape(-1, 1, 2)
    # OpenCV's own stubs demand the output array that OpenCV itself does without.
    flow: Any = cv2.calcOpticalFlowPyrLK
    moved, found, _ = flow(
        last, grey, points, None, winSize=_WINDOW, maxLevel=_LEVELS, criteria=_STOP
    )
    kept = found.ravel() > 0
    return _similarity(corners[kept], moved.reshape(-1, 2)[kept], factor)


def _outside(corners: npt.NDArray[Any], avoid: list[Box], factor: float) -> npt.NDArray[Any]:
    kept = np.ones(len(corners), bool)
    for box in avoid:
        across = np.abs(corners[:, 0] / factor - box.cx) < box.width / 2
        down = np.abs(corners[:, 1] / factor - box.cy) < box.height / 2
        kept &= ~(across & down)
    return corners[kept]


def _similarity(before: npt.NDArray[Any], after: npt.NDArray[Any], factor: float) -> Warp:
    if len(before) < _LEAST_INLIERS:
        return Warp()
    matrix, inliers = cv2.estimateAffinePartial2D(
        before, after, method=cv2.RANSAC, ransacReprojThreshold=_OUTLIER_PX
    )
    if matrix is None or inliers.sum() < max(_LEAST_INLIERS, _LEAST_INLIER_SHARE * len(before)):
        return Warp()
    warp = Warp(
        float(matrix[0, 0]),
        float(matrix[1, 0]),
        float(matrix[0, 2]) / factor,
        float(matrix[1, 2]) / factor,
    )
    believable = abs(math.log(max(warp.zoom, 1e-6))) < math.log(_MOST_ZOOM)
    return warp if believable else Warp()
