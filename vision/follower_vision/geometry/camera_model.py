"""The camera model: pixels to lines of sight and back.

A pinhole with the Brown-Conrady distortion of OpenCV's calibration (k1, k2, p1, p2, k3).
Camera frame: x right, y down, z forward along the optical axis. Pixel coordinates start at the
corner of the top-left pixel, whose own centre is therefore (0.5, 0.5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

Vector: TypeAlias = npt.NDArray[np.float64]

_SEEN_DEPTH, _LEAST_DEPTH = 0.5, 0.2
"""How far ahead of the camera a place is, as a share of its distance: from where on the lens
counts, and what counts at least, for places beside and behind it."""
_AT_US_M = 1e-6


@dataclass(frozen=True, slots=True)
class CameraModel:
    """Intrinsics of one camera at one image size.

    Attributes:
        width: image width in pixels.
        height: image height in pixels.
        fx: focal length in pixels, horizontally.
        fy: focal length in pixels, vertically.
        cx: principal point, x in pixels from the image's left edge.
        cy: principal point, y in pixels from the image's top edge.
        distortion: (k1, k2, p1, p2, k3) as OpenCV's calibration gives them.

    Raises:
        ValueError: a size or focal length is not positive, or a number is not finite.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        numbers = (self.width, self.height, self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not all(map(math.isfinite, numbers)):
            raise ValueError(f"a camera needs finite numbers, not {self}")
        if min(self.width, self.height, self.fx, self.fy) <= 0:
            raise ValueError(f"a camera needs a positive size and focal length, not {self}")

    @classmethod
    def from_fov(
        cls,
        width: int,
        height: int,
        horizontal_fov_rad: float,
        distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0),
    ) -> CameraModel:
        """Make a camera of square pixels, centred, from its undistorted horizontal field of view.

        Raises:
            ValueError: the field of view is not between 0 and 180 degrees.
        """
        if not 0 < horizontal_fov_rad < math.pi:
            raise ValueError(
                "the horizontal field of view lies between 0 and 180 degrees, "
                f"not {math.degrees(horizontal_fov_rad):g}"
            )
        focal = width / 2 / math.tan(horizontal_fov_rad / 2)
        return cls(width, height, focal, focal, width / 2, height / 2, distortion)

    @property
    def matrix(self) -> Vector:
        """The 3x3 camera matrix K."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], np.float64)

    @property
    def horizontal_fov_rad(self) -> float:
        """Horizontal field of view in radians, distortion left out."""
        return math.atan(self.cx / self.fx) + math.atan((self.width - self.cx) / self.fx)

    def resized(self, width: int, height: int) -> CameraModel:
        """Return the same lens at another image size (a scaled, not a cropped, image)."""
        across, down = width / self.width, height / self.height
        return CameraModel(
            width,
            height,
            self.fx * across,
            self.fy * down,
            self.cx * across,
            self.cy * down,
            self.distortion,
        )

    def rays(self, pixels: npt.ArrayLike) -> Vector:
        """Turn pixels, shape (N, 2), into unit vectors in the camera frame, shape (N, 3)."""
        points = np.asarray(pixels, np.float64).reshape(-1, 2)
        if any(self.distortion):
            criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
            plane = cv2.undistortPoints(
                points.reshape(-1, 1, 2),
                *_for_opencv(self),
                criteria=criteria,
            ).reshape(-1, 2)
        else:
            plane = (points - (self.cx, self.cy)) / (self.fx, self.fy)
        rays = np.ones((len(plane), 3))
        rays[:, :2] = plane
        x, y = plane.T
        rays /= np.sqrt(x * x + y * y + 1.0)[:, None]
        return rays

    def pixels(self, points: npt.ArrayLike) -> Vector:
        """Project points in the camera frame, shape (N, 3), to pixels, shape (N, 2).

        A point at or behind the camera's plane (z <= 0) has no image: its row is NaN.
        """
        # Row by row of (3, N), in one piece: numpy is slow on columns.
        x, y, depth = np.asarray(points, np.float64).reshape(-1, 3).T.copy()
        depth[~(depth > 0)] = np.nan
        x, y = self._distort(x / depth, y / depth)
        pixels = np.empty((len(depth), 2))
        pixels[:, 0], pixels[:, 1] = x * self.fx + self.cx, y * self.fy + self.cy
        return pixels

    def _distort(self, x: Vector, y: Vector) -> tuple[Vector, Vector]:
        if not any(self.distortion):
            return x, y
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )


@dataclass(frozen=True, slots=True, eq=False)
class CameraView:
    """Where a camera was and how it was turned when it took an image.

    Attributes:
        camera: its lens.
        turn: (3, 3), turns vectors of the camera's frame into the world's: north, east, down.
        place_m: (3,) where it was in the world, metres.
        angle_rad: what its directions may be wrong by.
    """

    camera: CameraModel
    turn: Vector
    place_m: Vector
    angle_rad: float = 0.0

    def pixels(self, away_m: Vector) -> Vector:
        """Return where in the image places are, (N, 2); `away_m` is (N, 3) from the camera.

        What is far beside the image or behind the camera is put so far beside it as the lens'
        straight lines would have it, on the right side.
        """
        points = sum(away_m[:, k : k + 1] * self.turn[k] for k in range(3))
        x, y, z = points.T
        distances = np.maximum(np.sqrt(x * x + y * y + z * z), _AT_US_M)
        depth = np.maximum(z, _LEAST_DEPTH * distances)
        pixels = np.empty((len(points), 2))
        pixels[:, 0] = self.camera.cx + self.camera.fx * x / depth
        pixels[:, 1] = self.camera.cy + self.camera.fy * y / depth
        seen = z > _SEEN_DEPTH * distances
        pixels[seen] = self.camera.pixels(points[seen])
        return pixels

    def directions(self, pixels: npt.ArrayLike) -> Vector:
        """Return the world's unit vectors towards pixels, (N, 3)."""
        rays = self.camera.rays(pixels)
        return np.asarray(sum(rays[:, k : k + 1] * self.turn[:, k] for k in range(3)))


@lru_cache(maxsize=16)
def _for_opencv(camera: CameraModel) -> tuple[Vector, Vector]:
    """Return the matrix and the distortion of a camera, which are read-only."""
    matrix, distortion = camera.matrix, np.array(camera.distortion)
    matrix.flags.writeable = distortion.flags.writeable = False
    return matrix, distortion
