"""A picture of the ground from above."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from follower_vision.camera import Vector
from follower_vision.frame import Image


@dataclass(frozen=True, slots=True)
class GroundMap:
    """A picture of the ground from above, north up.

    Attributes:
        image: BGR.
        north_m: of the top edge.
        east_m: of the left edge.
        m_per_px: size of a pixel on the ground.
    """

    image: Image
    north_m: float
    east_m: float
    m_per_px: float

    def pixels(self, points: npt.ArrayLike) -> Vector:
        """Turn (north, east) points, (N, 2) or (N, 3), into this map's pixels (x, y)."""
        p = np.asarray(points, np.float64)
        return np.column_stack(
            [(p[:, 1] - self.east_m) / self.m_per_px, (self.north_m - p[:, 0]) / self.m_per_px]
        )

    def halved(self) -> GroundMap:
        """Return the map at half the resolution."""
        height, width = self.image.shape[:2]
        small = cv2.resize(self.image, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
        return GroundMap(np.asarray(small, np.uint8), self.north_m, self.east_m, self.m_per_px * 2)
