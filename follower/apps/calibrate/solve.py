"""From views of the board to the lens, or to the reason why not."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from follower.apps.calibrate.views import BoardView, spread
from follower.apps.preflight.camera_checks import folds
from follower_vision.geometry.camera_model import CameraModel

COLUMNS, ROWS = 8, 6
LEAST_VIEWS = 8
_LEAST_COVERAGE, _GOOD_COVERAGE = 0.35, 0.7
_LEAST_TILTS_DEG = 15.0
_OUTLIER, _LEAST_OUTLIER_PX = 2.5, 0.3
_GOOD_ERROR_PX, _MOST_ERROR_PX = 0.5, 1.5
_MOST_FOCAL_DOUBT = 0.01
_FLAGS = cv2.CALIB_FIX_ASPECT_RATIO
"""Pixels are taken to be square: those of all sensors are, and one number less is to be found."""
_ENOUGH = 3
_ACROSS, _DOWN = ("left", "middle", "right"), ("top", "middle", "bottom")


class Coverage:
    """How many corners were seen in each cell of the image.

    Args:
        views: of the board.
        size: the image's width and height.

    Attributes:
        counts: (ROWS, COLUMNS) corners.
    """

    def __init__(self, views: Iterable[BoardView], size: tuple[int, int]) -> None:
        x, y = np.concatenate([np.empty((0, 2)), *(view.seen.image_px for view in views)]).T
        edges = np.linspace(0, size[1], ROWS + 1), np.linspace(0, size[0], COLUMNS + 1)
        self.counts: npt.NDArray[np.float64] = np.histogram2d(y, x, edges)[0]

    @property
    def covered(self) -> npt.NDArray[np.bool_]:
        """(ROWS, COLUMNS) whether there were corners enough."""
        return self.counts >= _ENOUGH

    @property
    def share(self) -> float:
        """Of the image's cells that are covered."""
        return float(self.covered.mean())

    def missing(self) -> list[str]:
        """Return the ninths of the image in which less than half is covered, in words."""
        names = []
        for down, rows in zip(_DOWN, np.array_split(self.covered, 3, axis=0), strict=True):
            for across, cells in zip(_ACROSS, np.array_split(rows, 3, axis=1), strict=True):
                if cells.mean() < 0.5:
                    names.append("middle" if down == across else f"{down} {across}")
        return names


class CalibrationError(ValueError):
    """The views do not determine the lens; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class LensCalibration:
    """What came out.

    Attributes:
        lens: for images of the size that was seen.
        views: that were used.
        normals: (N, 3) of the board in the camera's frame, one a used view.
        errors_px: (N,) root mean square distances between corners seen and corners computed.
        error_px: over all corners of the used views.
        focal_doubt: standard deviation of the focal length over itself, if nothing but the corners'
            noise is wrong.
        dropped: numbers of the images that fitted badly and were left out.
        warnings: what could be better, in words.
    """

    lens: CameraModel
    views: tuple[BoardView, ...]
    normals: npt.NDArray[np.float64]
    errors_px: npt.NDArray[np.float64]
    error_px: float
    focal_doubt: float
    dropped: tuple[int, ...] = ()
    warnings: tuple[str, ...] = ()


def calibrate(views: Sequence[BoardView], size: tuple[int, int]) -> LensCalibration:
    """Return the lens with which the views agree best (Zhang, 2000), without outliers.

    Of many views those that differ most are taken.

    Raises:
        CalibrationError: there are too few views, they are too much alike, or do not agree.
    """
    if len(views) < LEAST_VIEWS:
        raise CalibrationError(
            f"{len(views)} different views of the board are too few: {LEAST_VIEWS} are needed, 15 "
            "to 25 are good. Show it in all parts of the image, near and far, and tilted to each "
            "side"
        )
    views = kept = spread(views)
    fit = _fit(kept, size)
    while len(good := _inliers(fit)) < len(kept):
        if len(good) < LEAST_VIEWS:
            raise CalibrationError(
                f"only {len(good)} of {len(views)} views agree with each other: is the board flat, "
                "does the lens stand still (no autofocus, no zoom), was the right board named?"
            )
        kept = good
        fit = _fit(kept, size)
    _check_fit(fit)
    coverage = Coverage(kept, size)
    if coverage.share < _LEAST_COVERAGE:
        raise CalibrationError(
            f"the board was in {coverage.share:.0%} of the image only, so that nothing is known of "
            f"the lens elsewhere: show it at the {', '.join(coverage.missing())}"
        )
    used = {view.number for view in kept}
    dropped = tuple(view.number for view in views if view.number not in used)
    return replace(fit, dropped=dropped, warnings=tuple(_warnings(fit, coverage)))


def _fit(views: Sequence[BoardView], size: tuple[int, int]) -> LensCalibration:
    guess = CameraModel.from_fov(*size, math.radians(70.0))
    error, matrix, distortion, turns, _, deviations, _, errors = cv2.calibrateCameraExtended(
        [view.seen.board_m for view in views],
        [view.seen.image_px for view in views],
        size,
        guess.matrix,
        np.zeros(5),
        flags=_FLAGS | cv2.CALIB_USE_INTRINSIC_GUESS,
    )
    m = np.asarray(matrix, np.float64)
    # The corners were counted from the image's corner, so that its centre is, too.
    centre = float(m[0, 2]), float(m[1, 2])
    k1, k2, p1, p2, k3 = map(float, np.asarray(distortion).reshape(-1)[:5])
    lens = CameraModel(*size, float(m[0, 0]), float(m[1, 1]), *centre, (k1, k2, p1, p2, k3))
    normals = np.array([np.asarray(cv2.Rodrigues(turn)[0], np.float64)[:, 2] for turn in turns])
    doubt = float(np.asarray(deviations).reshape(-1)[1]) / lens.fx
    each = np.asarray(errors, np.float64).reshape(-1)
    return LensCalibration(lens, tuple(views), normals, each, float(error), doubt)


def _inliers(fit: LensCalibration) -> list[BoardView]:
    limit = max(_OUTLIER * float(np.median(fit.errors_px)), _LEAST_OUTLIER_PX)
    return [view for view, e in zip(fit.views, fit.errors_px, strict=True) if e <= limit]


def _check_fit(fit: LensCalibration) -> None:
    lens = fit.lens
    # The largest angle between any two of the board's directions.
    cosine = np.abs(fit.normals @ fit.normals.T).clip(0.0, 1.0).min()
    if math.degrees(math.acos(float(cosine))) < _LEAST_TILTS_DEG:
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
    if folds(lens):
        raise CalibrationError(
            "the distortion found folds the image before its corners: show the board in the "
            "corners, too; a fisheye needs another lens model"
        )


def _warnings(fit: LensCalibration, coverage: Coverage) -> list[str]:
    said = []
    if coverage.share < _GOOD_COVERAGE:
        missing = ", ".join(coverage.missing())
        where = f"at the {missing}" if missing else "elsewhere"
        said.append(
            f"the board was in {coverage.share:.0%} of the image: the distortion is a guess {where}"
        )
    if fit.error_px > _GOOD_ERROR_PX:
        said.append(
            f"corners lie {fit.error_px:.2f} px off: below {_GOOD_ERROR_PX:g} is usual; glue the "
            "board onto something flat, and hold it still"
        )
    return said
