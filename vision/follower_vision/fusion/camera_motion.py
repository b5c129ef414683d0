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
from follower_vision.fusion.global_shift import global_shift
from follower_vision.fusion.warp import Warp
from follower_vision.reduce import reduced

_WIDTH = 320
_CORNERS = 64
_ENOUGH = 40
_FRAMES_KEPT = 5
_QUALITY = 0.01
_APART = 7
_WINDOW = (11, 11)
_LEVELS = 3
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.03)
_OUTLIER_PX = 1.0
_LEAST_INLIERS = 12
_LEAST_INLIER_SHARE = 0.4
_VAIN = 2
_MOST_ZOOM = 1.2
_CALM_SIZES = 0.08
_STEADY_SIZES = 0.1
_AROUND_TARGET = 1.3

Grey = npt.NDArray[np.uint8]
Points = npt.NDArray[np.float32]


class CameraMotion:
    """Sparse optical flow (Lucas and Kanade) on a small grey image, then a robust similarity.

    Corners that agree are followed through a few images before they are looked for anew. Where too
    little of the background agrees, as when the camera swings fast, the image's shift as a whole
    counts; where there is none either, the motion is said to be none. Where corners were followed
    in vain twice, the shift comes first, and corners are tried every fifth time.

    A camera that moves evenly need not be measured in every image: see `foreseeable`.
    """

    def __init__(self) -> None:
        self._image: Image | None = None
        self._grey: Grey | None = None
        self._corners: Points = _NO_POINTS
        self._found: tuple[Grey, Points] | None = None
        self._kept = 0
        self._vain = 0
        self._warp = Warp()
        self._full: Grey | None = None
        self._pace: Warp | None = None
        self._even = self._foreseen = False
        self._since = Warp()

    def reset(self) -> None:
        """Forget the last image."""
        self._grey = self._full = self._image = None
        self._warp = Warp()
        self._pace, self._since = None, Warp()
        self._even = self._foreseen = False
        self._vain = 0

    def foreseeable(self, image: Image, boxes: Sequence[Box]) -> bool:
        """Tell whether the motion need not be measured in the next image.

        That is so if the last two measurements agreed, seen at the boxes, and the last image's
        motion was measured and small beside them.

        Args:
            image: the next image.
            boxes: what is followed, in the last image.
        """
        known = image is self._image or self._image is None or image.shape != self._image.shape
        if known or self._foreseen or not self._even or self._pace is None:
            return False
        return _calm(self._pace, boxes)

    def foresee(self, image: Image) -> Warp:
        """Take the next image without measuring; return how the camera moves if it goes on so.

        The next measurement reaches over this image too, so that errors do not add up.
        """
        self._image, self._warp = image, self._pace or Warp()
        self._since, self._foreseen = self._warp, True
        return self._warp

    def update(self, image: Image, avoid: Sequence[Box] = ()) -> Warp:
        """Return the motion from the last image to this one, (H, W, 3) uint8 BGR.

        Asked again for the same image object, it answers the same without working.

        Args:
            image: the next image.
            avoid: boxes in the last image that move by themselves; what is foreseen later has to
                be even at them.
        """
        if image is not self._image:
            self._image = image
            self._warp = self._since_foreseen(image, avoid)
        return self._warp

    def seek(self) -> None:
        """Find corners in the last image measured, if those followed will not do for the next.

        `update` finds them itself where this was not called: it may be left out, or called in
        another thread after `update`, and changes no answer.
        """
        grey, flows = self._grey, self._vain < _VAIN or self._vain % _FRAMES_KEPT == 0
        worn = self._kept >= _FRAMES_KEPT or len(self._corners) < _ENOUGH
        if grey is not None and flows and worn:
            self._found = grey, _corners(grey)

    @property
    def grey(self) -> Grey | None:
        """The last image in grey, (H, W), if it was measured: then it was needed anyway."""
        return None if self._foreseen else self._full

    def _since_foreseen(self, image: Image, avoid: Sequence[Box]) -> Warp:
        """Measure, and take off what was foreseen since the last measurement."""
        back = self._since.back()
        total = self._measure(image, [back.box(box) for box in avoid])
        pace = total.halved() if total is not None and self._foreseen else total
        self._even = pace is not None and _agree(self._pace, pace, avoid)
        self._pace, self._since, self._foreseen = pace, Warp(), False
        return back.then(total or Warp())

    def _measure(self, image: Image, avoid: Sequence[Box]) -> Warp | None:
        """Return the motion from the last image measured; None if there is nothing to measure."""
        factor = min(1.0, _WIDTH / image.shape[1])
        self._full = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        size = round(image.shape[1] * factor), round(image.shape[0] * factor)
        last, self._grey = self._grey, reduced(self._full, *size)
        if last is None or last.shape != self._grey.shape:
            self._corners = _NO_POINTS
            return None
        around = [box.scaled(_AROUND_TARGET) for box in avoid]
        if self._vain < _VAIN or self._vain % _FRAMES_KEPT == 0:
            flow = self._flow(last, self._grey, around, factor)
            self._vain = self._vain + 1 if flow is None else 0
            return flow or _shifted(last, self._grey, factor)
        self._vain += 1
        self._corners = _NO_POINTS
        shift = _shifted(last, self._grey, factor)
        return shift or self._flow(last, self._grey, around, factor)

    def _flow(self, last: Grey, grey: Grey, avoid: list[Box], factor: float) -> Warp | None:
        before, after = _followed(last, grey, self._background(last, avoid, factor))
        warp, agreeing = _similarity(before, after, factor)
        self._corners = after[agreeing]
        return warp

    def _background(self, last: Grey, avoid: list[Box], factor: float) -> Points:
        """Corners in the last image: those followed there, or new ones."""
        self._kept += 1
        if self._kept <= _FRAMES_KEPT:
            points = _outside(self._corners, avoid, factor)
            if len(points) >= _ENOUGH:
                return points
        self._kept = 0
        found, self._found = self._found, None
        points = found[1] if found is not None and found[0] is last else _corners(last)
        return _outside(points, avoid, factor)


def _calm(pace: Warp, boxes: Sequence[Box]) -> bool:
    """Whether the background moves little at the boxes."""
    return bool(boxes) and all(
        pace.box(box).distance(box) < _CALM_SIZES * box.scale for box in boxes
    )


def _agree(before: Warp | None, now: Warp, boxes: Sequence[Box]) -> bool:
    """Whether the camera goes on as before, seen at the boxes."""
    return (
        before is not None
        and bool(boxes)
        and all(now.box(box).distance(before.box(box)) < _STEADY_SIZES * box.scale for box in boxes)
    )


_NO_POINTS: Points = np.zeros((0, 2), np.float32)


def _followed(last: Grey, grey: Grey, points: Points) -> tuple[Points, Points]:
    """Return the points that are found in the next image, and where they are there.

    Points too few to tell anything are not looked for.
    """
    if len(points) < _LEAST_INLIERS:
        return _NO_POINTS, _NO_POINTS
    # OpenCV's own stubs demand the output array that OpenCV itself does without.
    flow: Any = cv2.calcOpticalFlowPyrLK
    moved, found, _ = flow(
        last, grey, points[:, None], None, winSize=_WINDOW, maxLevel=_LEVELS, criteria=_STOP
    )
    kept = found.ravel() > 0
    return points[kept], moved[kept, 0]


def _corners(grey: Grey) -> Points:
    corners: Any = cv2.goodFeaturesToTrack(grey, _CORNERS, _QUALITY, _APART)
    return _NO_POINTS if corners is None else np.asarray(corners.reshape(-1, 2), np.float32)


def _outside(corners: Points, avoid: list[Box], factor: float) -> Points:
    kept = np.ones(len(corners), bool)
    for box in avoid:
        across = np.abs(corners[:, 0] / factor - box.cx) < box.width / 2
        down = np.abs(corners[:, 1] / factor - box.cy) < box.height / 2
        kept &= ~(across & down)
    return corners[kept]


def _similarity(
    before: Points, after: Points, factor: float
) -> tuple[Warp | None, npt.NDArray[np.bool_]]:
    """Return the motion, if there is one to be believed, and which points agree."""
    none = np.zeros(len(before), bool)
    if len(before) < _LEAST_INLIERS:
        return None, none
    matrix, agreeing = cv2.estimateAffinePartial2D(
        before, after, method=cv2.RANSAC, ransacReprojThreshold=_OUTLIER_PX, refineIters=0
    )
    inliers = none if matrix is None else agreeing.ravel() > 0
    least = max(_LEAST_INLIERS, _LEAST_INLIER_SHARE * len(before))
    if np.count_nonzero(inliers) < least:
        return None, none
    warp = _fitted(before[inliers], after[inliers], factor)
    believable = abs(math.log(max(warp.zoom, 1e-6))) < math.log(_MOST_ZOOM)
    return (warp, inliers) if believable else (None, none)


def _fitted(before: Points, after: Points, factor: float) -> Warp:
    """Return the similarity with the least squares, in closed form, by complex numbers.

    OpenCV's own refinement comes to the same, in ten iterations that take ten times as long.
    """
    start, end = (points.astype(np.float64).view(np.complex128)[:, 0] for points in (before, after))
    middle, there = start.mean(), end.mean()
    start -= middle
    # Points that all lie in one place give no size: nothing of 0 is believed.
    turn = complex(np.vdot(start, end)) / max(float(np.vdot(start, start).real), 1e-9)
    shift = complex(there - turn * middle) / factor
    return Warp(turn.real, turn.imag, shift.real, shift.imag)


def _shifted(last: Grey, grey: Grey, factor: float) -> Warp | None:
    shift = global_shift(last, grey)
    return None if shift is None else Warp(right=shift[0] / factor, down=shift[1] / factor)
