"""From views of the board to the lens, or to the reason why not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from follower.calibration.coverage import Coverage
from follower.calibration.views import View
from follower_vision.camera import CameraModel

LEAST_VIEWS = 8
_LEAST_COVERAGE, _GOOD_COVERAGE = 0.35, 0.7
_LEAST_TILTS_DEG = 15.0
_OUTLIER, _LEAST_OUTLIER_PX = 2.5, 0.3
_GOOD_ERROR_PX, _MOST_ERROR_PX = 0.5, 1.5
_MOST_FOCAL_DOUBT = 0.01
_FLAGS = cv2.CALIB_FIX_ASPECT_RATIO
"""Pixels are taken to be square: those of all sensors are, and one number less is to be found."""


class CalibrationError(ValueError):
    """The views do not tell the lens; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """What came out.

    Attributes:
        lens: for images of the size that was seen.
        views: that were used.
        errors_px: (number of the image, root mean square distance between corners seen and
            corners computed), one a used view.
        dropped: numbers of the images that fitted badly and were left out.
        error_px: over all corners of the used views.
        focal_doubt: standard deviation of the focal length over itself, if nothing but the corners'
            noise is wrong.
        warnings: what could be better, in words.
    """

    lens: CameraModel
    views: tuple[View, ...]
    errors_px: tuple[tuple[int, float], ...]
    dropped: tuple[int, ...]
    error_px: float
    focal_doubt: float
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Fit:
    matrix: npt.NDArray[np.float64]
    distortion: npt.NDArray[np.float64]
    normals: npt.NDArray[np.float64]
    errors_px: npt.NDArray[np.float64]
    error_px: float
    focal_doubt: float


def calibrate(views: Sequence[View], size: tuple[int, int]) -> Calibration:
    """Return the lens with which the views agree best (Zhang, 2000), without outliers.

    Raises:
        CalibrationError: there are too few views, they are too much alike, or do not agree.
    """
    _check_number(len(views))
    kept = list(views)
    fit = _fit(kept, size)
    while len(good := _inliers(kept, fit)) < len(kept):
        if len(good) < LEAST_VIEWS:
            raise CalibrationError(
                f"only {len(good)} of {len(views)} views agree with each other: is the board flat, "
                "does the lens stand still (no autofocus, no zoom), was the right board named?"
            )
        kept = good
        fit = _fit(kept, size)
    lens = _lens(fit, size)
    _check_fit(fit, lens)
    coverage = Coverage(kept, size)
    _check_coverage(coverage)
    used = {view.number for view in kept}
    return Calibration(
        lens,
        tuple(kept),
        tuple((view.number, float(e)) for view, e in zip(kept, fit.errors_px, strict=True)),
        tuple(view.number for view in views if view.number not in used),
        fit.error_px,
        fit.focal_doubt,
        tuple(_warnings(fit, coverage)),
    )


def _check_number(views: int) -> None:
    if views < LEAST_VIEWS:
        raise CalibrationError(
            f"{views} different views of the board are too few: {LEAST_VIEWS} are needed, 15 to 25 "
            "are good. Show it in all parts of the image, near and far, and tilted to each side"
        )


def _fit(views: Sequence[View], size: tuple[int, int]) -> _Fit:
    guess = CameraModel.from_fov(*size, math.radians(70.0))
    error, matrix, distortion, turns, _, deviations, _, errors = cv2.calibrateCameraExtended(
        [view.seen.board_m for view in views],
        [view.seen.image_px for view in views],
        size,
        guess.matrix,
        np.zeros(5),
        flags=_FLAGS | cv2.CALIB_USE_INTRINSIC_GUESS,
    )
    found: npt.NDArray[np.float64] = np.asarray(matrix, np.float64)
    normals = np.array([np.asarray(cv2.Rodrigues(turn)[0], np.float64)[:, 2] for turn in turns])
    doubt = float(np.asarray(deviations).reshape(-1)[1]) / float(found[0, 0])
    flat = np.asarray(distortion, np.float64).reshape(-1)[:5]
    each = np.asarray(errors, np.float64).reshape(-1)
    return _Fit(found, flat, normals, each, float(error), doubt)


def _inliers(views: Sequence[View], fit: _Fit) -> list[View]:
    limit = max(_OUTLIER * float(np.median(fit.errors_px)), _LEAST_OUTLIER_PX)
    return [view for view, e in zip(views, fit.errors_px, strict=True) if e <= limit]


def _lens(fit: _Fit, size: tuple[int, int]) -> CameraModel:
    """Return the lens in our pixels, and with OpenCV's (k1, k2, p1, p2, k3)."""
    k1, k2, p1, p2, k3 = map(float, fit.distortion)
    m = fit.matrix
    # The corners were counted from the image's corner, so that its centre is, too.
    return CameraModel(
        *size, float(m[0, 0]), float(m[1, 1]), float(m[0, 2]), float(m[1, 2]), (k1, k2, p1, p2, k3)
    )


def _check_fit(fit: _Fit, lens: CameraModel) -> None:
    if _tilts_deg(fit.normals) < _LEAST_TILTS_DEG:
        raise CalibrationError(
            "the board always faces the camera the same way, which cannot tell a long lens from a "
            "board far away: tilt it by 30 degrees or so, to the left, to the right, up and down"
        )
    if not fit.error_px <= _MOST_ERROR_PX:
        raise CalibrationError(
            f"the corners lie {fit.error_px:.1f} px from where they should be: is the board flat, "
            "was the right board named (--kind, --squares)? A fisheye needs another lens model"
        )
    inside = 0 < lens.cx < lens.width and 0 < lens.cy < lens.height
    if not inside or not fit.focal_doubt <= _MOST_FOCAL_DOUBT:
        raise CalibrationError(
            f"the focal length is known to {fit.focal_doubt:.1%} only: take more views, tilt the "
            "board more, and fill more of the image with it"
        )


def _tilts_deg(normals: npt.NDArray[np.float64]) -> float:
    """Return the largest angle between any two of the board's directions."""
    cosines = np.abs(normals @ normals.T).clip(0.0, 1.0)
    return math.degrees(math.acos(float(cosines.min())))


def _check_coverage(coverage: Coverage) -> None:
    if coverage.share < _LEAST_COVERAGE:
        raise CalibrationError(
            f"the board was in {coverage.share:.0%} of the image only, so that nothing is known of "
            f"the lens elsewhere: show it at the {', '.join(coverage.missing())}"
        )


def _warnings(fit: _Fit, coverage: Coverage) -> list[str]:
    said = []
    if coverage.share < _GOOD_COVERAGE:
        missing = ", ".join(coverage.missing())
        said.append(
            f"the board was in {coverage.share:.0%} of the image: the distortion is a guess at the "
            f"{missing}"
        )
    if fit.error_px > _GOOD_ERROR_PX:
        said.append(
            f"corners lie {fit.error_px:.2f} px off: below {_GOOD_ERROR_PX:g} is usual; glue the "
            "board onto something flat, and hold it still"
        )
    return said
