"""Where the target is believed to be, predicted to one moment."""

from __future__ import annotations

from dataclasses import dataclass

from follower_control.sighting import SightFrame, from_sight
from follower_vision.camera import Vector
from follower_vision.lineofsight import LineOfSight


@dataclass(frozen=True, slots=True, eq=False)
class TargetEstimate:
    """The target's direction and angular size, with their rates.

    Attributes:
        time_s: the moment for which this holds.
        azimuth_rad: in [-pi, pi), from north (world) or from the nose (body), right is positive;
            see `SightFrame` for what it is from straight down.
        elevation_rad: up is positive, or north from straight down.
        log_scale: natural logarithm of the angular size in radians.
        azimuth_rate_rad_s: how fast the azimuth changes.
        elevation_rate_rad_s: how fast the elevation changes.
        log_scale_rate_s: how fast the log scale changes, 1/s; positive while it comes nearer.
        covariance: 6x6, in the order of the six numbers above. Nobody writes into it.
        last_seen_s: time of the last sighting that went into the filter.
        frame: what the angles are measured against.
    """

    time_s: float
    azimuth_rad: float
    elevation_rad: float
    log_scale: float
    azimuth_rate_rad_s: float
    elevation_rate_rad_s: float
    log_scale_rate_s: float
    covariance: Vector
    last_seen_s: float
    frame: SightFrame

    @property
    def direction(self) -> Vector:
        """Unit vector: north, east, down, or in the body's frame forward, right, down."""
        return from_sight(LineOfSight(self.azimuth_rad, self.elevation_rad), self.frame)

    @property
    def height_angle_rad(self) -> float:
        """The target's elevation from the horizontal, or from the body's plane; up is positive."""
        if self.frame is not SightFrame.DOWN:
            return self.elevation_rad
        return LineOfSight.from_vector(self.direction).elevation_rad

    @property
    def age_s(self) -> float:
        """For how long the target has not been seen."""
        return self.time_s - self.last_seen_s
