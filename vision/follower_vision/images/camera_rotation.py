"""How fast the camera turns, measured from image to image alone."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.geometry.camera_model import CameraModel, Vector
from follower_vision.images.frame import Frame, Image

_WIDTH = 480
_CORNERS = 120
_QUALITY = 0.01
_APART = 8
_WINDOW = (15, 15)
_LEVELS = 3
_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 15, 0.02)
_BACK_PX = 0.5
"""A corner that does not come back to its place when it is followed backwards does not count."""
_LEAST_CORNERS = 12
_ROUNDS = 8
_FINEST_PX = 0.1

Grey = npt.NDArray[np.uint8]
Points = npt.NDArray[np.float32]
_NO_POINTS: Points = np.empty((0, 2), np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class CornerFlow:
    """Directions to the same things in two frames.

    Attributes:
        start_s: capture time of the first frame.
        end_s: of the second.
        old: (N, 3) unit vectors in the first frame's camera axes: right, down, forward.
        new: (N, 3) the same in the second's.
        finest: a hundredth of a pixel or so as an angle, radians: differences below it are noise.
    """

    start_s: float
    end_s: float
    old: Vector
    new: Vector
    finest: float

    def rates_rad_s(self, down: Vector | None = None) -> Vector | None:
        """Return the camera's mean angular velocity, (3,); None where too little is seen.

        About the camera's axes right, down and forward: looking up, turning to the right and
        rolling clockwise are positive.

        Args:
            down: direction of gravity in camera axes, to tell the camera's own way over the ground
                from a turn; without it everything counts as a turn.
        """
        if len(self.old) < _LEAST_CORNERS:
            return None
        turn = fit_rotation(self.old, self.new, down, self.finest)
        return turn / (self.end_s - self.start_s)


class CornerFollower:
    """Follows corners from each frame to the next (Lucas and Kanade).

    Args:
        camera: intrinsics at the frames' size.
    """

    def __init__(self, camera: CameraModel) -> None:
        width = min(_WIDTH, camera.width)
        height = max(1, round(camera.height * width / camera.width))
        self._camera = camera.resized(width, height)
        self._size = width, height
        self._grey: Grey | None = None
        self._time_s = 0.0

    def step(self, frame: Frame) -> CornerFlow | None:
        """Return what has moved since the frame before, None for the first.

        Raises:
            ValueError: the frames' times stand still or run backwards.
        """
        before, start_s = self._grey, self._time_s
        self._grey, self._time_s = self._small(frame.image), frame.captured_s
        if before is None:
            return None
        if not frame.captured_s > start_s:
            raise ValueError(f"a frame comes after the one before, not {frame.captured_s:g} s")
        old, new = _followed(before, self._grey)
        rays = (self._rays(old), self._rays(new))
        return CornerFlow(start_s, frame.captured_s, *rays, _FINEST_PX / self._camera.fx)

    def _rays(self, points: Points) -> Vector:
        return self._camera.rays(points) if len(points) else np.empty((0, 3))

    def _small(self, image: Image) -> Grey:
        grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        return np.asarray(cv2.resize(grey, self._size, interpolation=cv2.INTER_AREA), np.uint8)


def fit_rotation(
    old: Vector, new: Vector, down: Vector | None = None, finest: float = 1e-4
) -> Vector:
    """Return the small rotation vector of a camera that sees `old` turn into `new`.

    A turn w moves a direction r by r x w. A way v over flat ground moves it by -(v - (v.r) r) times
    how near the ground is there, which is in proportion to `down`.r. Both are solved for at once by
    least squares, iterated with Tukey's weights, so that what moves by itself does not count.

    Args:
        old: unit vectors in the camera frame, shape (N, 3), N at least 4.
        new: the same directions in the turned camera's frame.
        down: direction of gravity in camera axes; None leaves the way over the ground out.
        finest: residuals of this size, radians, are noise at any rate.

    Returns:
        (3,) radians about the camera's axes.
    """
    middle, moved = (old + new) / 2, new - old
    equations = _cross_matrices(middle)
    if down is not None:
        equations = np.concatenate([equations, _parallax_matrices(middle, down)], axis=2)
    weights = np.ones(len(old))
    found = np.zeros(equations.shape[2])
    for _ in range(_ROUNDS):
        weighted = equations * weights[:, None, None]
        normal = np.einsum("nij,nik->jk", weighted, equations)
        found = np.linalg.lstsq(normal, np.einsum("nij,ni->j", weighted, moved), rcond=1e-9)[0]
        left = np.linalg.norm(moved - equations @ found, axis=1)
        limit = 4.685 * max(1.4826 * float(np.median(left)), finest)
        weights = np.square(1 - np.square(np.minimum(left / limit, 1.0)))
    return np.asarray(found[:3], np.float64)


def _parallax_matrices(rays: Vector, down: Vector) -> Vector:
    """Return the matrices D with D v = how a way v over flat ground moves a ray, (N, 3, 3)."""
    near = np.maximum(rays @ down, 0.0)
    along = rays[:, :, None] * rays[:, None, :]
    return np.asarray((along - np.eye(3)) * near[:, None, None], np.float64)


def _cross_matrices(vectors: Vector) -> Vector:
    """Return the matrices C with C w = v x w, shape (N, 3, 3)."""
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.moveaxis(np.array(rows), 2, 0)


def _followed(before: Grey, after: Grey) -> tuple[Points, Points]:
    """Return corners of the one image and where they are in the other, (N, 2) each, in pixels."""
    found: Any = cv2.goodFeaturesToTrack(before, _CORNERS, _QUALITY, _APART)
    if found is None:
        return _NO_POINTS, _NO_POINTS
    corners = np.asarray(found, np.float32).reshape(-1, 1, 2)
    there, seen = _flow(before, after, corners)
    back, returned = _flow(after, before, there)
    strayed = np.linalg.norm(back - corners, axis=2).ravel()
    good = seen & returned & (strayed < _BACK_PX)
    # OpenCV counts from the middle of the top-left pixel.
    return corners.reshape(-1, 2)[good] + 0.5, there.reshape(-1, 2)[good] + 0.5


def _flow(before: Grey, after: Grey, points: Points) -> tuple[Points, npt.NDArray[np.bool_]]:
    guess: Any = None
    moved, status, _ = cv2.calcOpticalFlowPyrLK(
        before, after, points, guess, winSize=_WINDOW, maxLevel=_LEVELS, criteria=_STOP
    )
    return np.asarray(moved, np.float32), np.asarray(status).ravel() == 1
