"""One look at the target: where it stood and how large it looked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from follower_vision.camera import Vector
from follower_vision.lineofsight import LineOfSight


class SightFrame(StrEnum):
    """What a direction is measured against."""

    WORLD = "world"
    """Level; azimuth from north. The vehicle's own turning and tilting are taken out."""
    DOWN = "down"
    """The same turned over, for targets below, where an azimuth from north says nothing: azimuth
    from straight down to the east, elevation from there to the north."""
    BODY = "body"
    """Azimuth from the nose, elevation from the body's plane: all that an image alone says."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """The target's direction and angular size at one moment.

    Attributes:
        line_of_sight: direction of the box's centre, in `frame`.
        log_scale: natural logarithm of the angular size in radians, which is the square root of
            angular width times angular height. It grows as the target comes nearer: its rate is
            minus the rate of range over range.
        time_s: when the image was taken, on the system's clock.
        frame: what the direction is measured against.
        is_cut: the image's border cuts the box, so that size and centre are doubtful.
    """

    line_of_sight: LineOfSight
    log_scale: float
    time_s: float
    frame: SightFrame = SightFrame.WORLD
    is_cut: bool = False

    @property
    def values(self) -> tuple[float, float, float]:
        """(azimuth, elevation, log scale) in radians, radians and 1."""
        return self.line_of_sight.azimuth_rad, self.line_of_sight.elevation_rad, self.log_scale

    @property
    def is_finite(self) -> bool:
        """Whether direction, size and time are all finite."""
        return all(map(math.isfinite, (*self.values, self.time_s)))


def to_sight(vector: Vector, frame: SightFrame) -> LineOfSight:
    """Return the direction of a vector (north, east, down) or (forward, right, down)."""
    if frame is SightFrame.DOWN:
        north, east, down = vector
        vector = np.array([down, east, -north])
    return LineOfSight.from_vector(vector)


def from_sight(sight: LineOfSight, frame: SightFrame) -> Vector:
    """Return the unit vector whose direction this is: the inverse of `to_sight`."""
    vector = sight.vector
    if frame is not SightFrame.DOWN:
        return vector
    down, east, south = vector
    return np.array([-south, east, down])
