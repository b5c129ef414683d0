"""Where the target is believed to be, predicted to one time, and what follows from that.

Horizontal vectors are complex: north + 1j * east in the world's frames, forward + 1j * right in the
body's.
"""

import cmath
import math
from dataclasses import dataclass, replace

import numpy as np

from follower_control.target.observation import BearingFrame, to_vector
from follower_control.vehicle.history import turned_on
from follower_control.vehicle.state import VehicleState
from follower_vision.geometry.camera_model import Vector
from follower_vision.geometry.line_of_sight import LineOfSight, wrap_angle

OLD_S = 0.5
"""Older telemetry is not used; after a longer pause the loops begin anew."""
_AHEAD_S = 0.1
_NEAREST_M = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class TargetEstimate:
    """The target's direction and angular size, with their rates.

    Attributes:
        time_s: the time for which this holds.
        azimuth_rad: in [-pi, pi), from north (world) or from the nose (body), right is positive;
            see `BearingFrame` for what it is from straight down.
        elevation_rad: up is positive, or north from straight down.
        log_scale: natural logarithm of the angular size in radians.
        azimuth_rate_rad_s: how fast the azimuth changes.
        elevation_rate_rad_s: how fast the elevation changes.
        log_scale_rate_s: how fast the log scale changes, 1/s; positive while it comes nearer.
        covariance: 6x6, in the order of the six numbers above. Nobody writes into it.
        last_seen_s: time of the last observation that went into the filter.
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
    frame: BearingFrame

    @property
    def values(self) -> tuple[float, float, float, float, float, float]:
        """(azimuth, elevation, log scale) and their rates, in the covariance's order."""
        return (
            *(self.azimuth_rad, self.elevation_rad, self.log_scale),
            *(self.azimuth_rate_rad_s, self.elevation_rate_rad_s, self.log_scale_rate_s),
        )

    @property
    def direction(self) -> Vector:
        """Unit vector: north, east, down, or in the body's frame forward, right, down."""
        return to_vector(LineOfSight(self.azimuth_rad, self.elevation_rad), self.frame)

    @property
    def height_angle_rad(self) -> float:
        """The target's elevation from the horizontal, or from the body's plane; up is positive."""
        if self.frame is not BearingFrame.DOWN:
            return self.elevation_rad
        return LineOfSight.from_vector(self.direction).elevation_rad

    @property
    def age_s(self) -> float:
        """For how many seconds the target has not been seen."""
        return self.time_s - self.last_seen_s


def offset(estimate: TargetEstimate, range_m: float) -> complex:
    """Return the horizontal vector from us to a target at this distance, metres."""
    ahead, right, _ = estimate.direction.tolist()
    return range_m * complex(ahead, right)


def offset_rate(estimate: TargetEstimate, range_m: float) -> complex:
    """Return the rate of `offset`, m/s: what the target's own motion and ours make together."""
    closing = -estimate.log_scale_rate_s * offset(estimate, range_m)
    azimuth, elevation = estimate.azimuth_rad, estimate.elevation_rad
    turn, rise = estimate.azimuth_rate_rad_s, estimate.elevation_rate_rad_s
    level, steep = math.cos(elevation), math.sin(elevation)
    if estimate.frame is BearingFrame.DOWN:
        east = level * math.cos(azimuth) * turn - steep * math.sin(azimuth) * rise
        return closing + range_m * complex(level * rise, east)
    return closing + range_m * cmath.rect(1.0, azimuth) * complex(-steep * rise, level * turn)


def level_rate(estimate: TargetEstimate, range_m: float) -> float:
    """Return how fast the horizontal distance to a target at this distance grows, m/s."""
    away = cmath.phase(offset(estimate, range_m))
    return (offset_rate(estimate, range_m) * cmath.rect(1.0, -away)).real


def azimuth_of(estimate: TargetEstimate) -> float:
    """Return the azimuth from north, or from the nose in the body's frame."""
    if estimate.frame is BearingFrame.DOWN:
        return cmath.phase(offset(estimate, 1.0))
    return estimate.azimuth_rad


def heading_at(estimate: TargetEstimate, vehicle: VehicleState) -> float | None:
    """Return the heading at the estimate's time, in the estimate's frame; None if unknown."""
    if estimate.frame is BearingFrame.BODY:
        return 0.0
    age_s = vehicle.attitude_age_s(estimate.time_s)
    if vehicle.attitude is None or age_s > OLD_S:
        return None
    return turned_on(vehicle.attitude, min(max(age_s, -_AHEAD_S), _AHEAD_S)).yaw_rad


def centred_share(azimuth_rad: float, centred_rad: float, off_axis_rad: float) -> float:
    """Return 1 for a target ahead, falling smoothly to 0 for one off-axis; angles in rad."""
    x = min(max((off_axis_rad - abs(azimuth_rad)) / (off_axis_rad - centred_rad), 0.0), 1.0)
    return x * x * (3 - 2 * x)


def seen_again(estimate: TargetEstimate) -> TargetEstimate:
    """Return the estimate for the time of the last observation, from which it was predicted."""
    age_s = estimate.age_s
    return replace(
        estimate,
        time_s=estimate.last_seen_s,
        azimuth_rad=wrap_angle(estimate.azimuth_rad - age_s * estimate.azimuth_rate_rad_s),
        elevation_rad=estimate.elevation_rad - age_s * estimate.elevation_rate_rad_s,
        log_scale=estimate.log_scale - age_s * estimate.log_scale_rate_s,
    )


def reproject(
    estimate: TargetEstimate, away_m: Vector, rate_m_s: Vector, size_m: float
) -> TargetEstimate:
    """Return the estimate of a target that is so far away and moves so against us.

    Args:
        estimate: whose frame, time and covariance are kept; of the world.
        away_m: (3,) from us to the target, north, east, down.
        rate_m_s: (3,) its rate.
        size_m: the target's size.
    """
    ahead, right, down = _turned(away_m, estimate.frame)
    ahead_rate, right_rate, down_rate = _turned(rate_m_s, estimate.frame)
    level = max(math.hypot(ahead, right), _NEAREST_M)
    range2 = level * level + down * down
    level_rate = (ahead * ahead_rate + right * right_rate) / level
    return TargetEstimate(
        time_s=estimate.time_s,
        azimuth_rad=math.atan2(right, ahead),
        elevation_rad=math.atan2(-down, level),
        log_scale=math.log(size_m) - math.log(range2) / 2,
        azimuth_rate_rad_s=(ahead * right_rate - right * ahead_rate) / level**2,
        elevation_rate_rad_s=(down * level_rate - level * down_rate) / range2,
        log_scale_rate_s=-(level * level_rate + down * down_rate) / range2,
        covariance=estimate.covariance,
        last_seen_s=estimate.last_seen_s,
        frame=estimate.frame,
    )


def _turned(vector: Vector, frame: BearingFrame) -> tuple[float, float, float]:
    """Return a vector in the axes in which the frame measures angles; see `to_line_of_sight`."""
    north, east, down = np.asarray(vector).tolist()
    return (down, east, -north) if frame is BearingFrame.DOWN else (north, east, down)


_LOWEST_M = 1.0
"""Below this height, its error is too large a share of it for a range."""
_FLATTEST_RAD = math.radians(5)
"""So flat a line of sight meets the ground far away, and the error of the angle counts most."""
_MARGIN = 1.25
"""What slopes and the error of the height may add."""


def range_to_ground(height_m: float, elevation_rad: float) -> float:
    """Return after how many metres a line of sight meets level ground, with some margin.

    No target is farther away than that, whatever its box says: a box that has shrunk onto a part
    of the target must not pull the vehicle into it. Infinite where nothing can be said: close to
    the ground, and for a flat or rising line of sight.

    Args:
        height_m: above the ground, taken to be level.
        elevation_rad: of the line of sight from the horizontal, negative looks down; a prediction
            that has passed below us counts as straight down.
    """
    elevation_rad = max(elevation_rad, -math.pi / 2)
    if height_m < _LOWEST_M or elevation_rad > -_FLATTEST_RAD:
        return math.inf
    return _MARGIN * height_m / math.sin(-elevation_rad)


def ranged_by_ground(
    estimate: TargetEstimate, size_m: float, above_m: float, climb_m_s: float
) -> TargetEstimate:
    """Return the estimate with the size that fits to where its line of sight meets the ground.

    Unchanged where nothing can be said: too low, too flat a line of sight, or no telemetry.

    Args:
        estimate: of a target on the ground.
        size_m: the size in metres that stands for the target.
        above_m: our height above the target's middle.
        climb_m_s: how fast that grows.
    """
    elevation = max(estimate.height_angle_rad, -math.pi / 2)
    if above_m < _LOWEST_M or elevation > -_FLATTEST_RAD or estimate.frame is BearingFrame.BODY:
        return estimate
    range_m = above_m / math.sin(-elevation)
    growth = climb_m_s / above_m
    if estimate.frame is BearingFrame.WORLD:
        growth -= estimate.elevation_rate_rad_s / math.tan(elevation)
    return replace(estimate, log_scale=math.log(size_m / range_m), log_scale_rate_s=-growth)
