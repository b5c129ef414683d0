"""Where the target is in the world, and how fast it goes, with how sure that is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from follower_control.estimate import TargetEstimate
from follower_control.servo_settings import RangeFrom, ServoSettings
from follower_control.sighting import SightFrame, from_sight
from follower_control.vehicle import LocalPosition, VehicleState
from follower_vision.camera import Vector
from follower_vision.lineofsight import LineOfSight

_STALE_S = 0.5
_LOWEST_M = 1.0
_FLATTEST_RAD = math.radians(5)
_STEP = 1e-5


@dataclass(frozen=True, slots=True)
class TargetFixSettings:
    """What the estimate's covariance does not know of, as standard deviations.

    Attributes:
        attitude_deg: of the attitude with which a line of sight was turned, and of the mount.
        size_share: of the target's size as seen, as a share of it: it differs from side to side.
        height_m: of our height above the ground on which the target stands.
        position_m: of our own position, along each axis.
        velocity_m_s: of our own velocity, likewise.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    attitude_deg: float = 1.0
    size_share: float = 0.2
    height_m: float = 0.5
    position_m: float = 0.5
    velocity_m_s: float = 0.3

    def __post_init__(self) -> None:
        if not all(0 <= getattr(self, name) < 100 for name in self.__slots__):
            raise ValueError(f"standard deviations lie between 0 and 100, not {self}")


@dataclass(frozen=True, slots=True, eq=False)
class TargetFix:
    """The target in the world.

    Attributes:
        time_s: the moment for which this holds.
        position_m: north, east, down from the origin of local positions.
        velocity_m_s: north, east, down.
        covariance: 6x6, of position and velocity in this order. Nobody writes into it.
        range_m: from us.
    """

    time_s: float
    position_m: tuple[float, float, float]
    velocity_m_s: tuple[float, float, float]
    covariance: Vector
    range_m: float

    @property
    def horizontal_m(self) -> float:
        """Standard deviation of the horizontal position, along its worse axis."""
        return _largest_deviation(self.covariance[:2, :2])

    @property
    def vertical_m(self) -> float:
        """Standard deviation of the height."""
        return math.sqrt(max(float(self.covariance[2, 2]), 0.0))

    @property
    def speed_m_s(self) -> float:
        """Standard deviation of the velocity, along its worst axis."""
        return _largest_deviation(self.covariance[3:, 3:])


def target_fix(
    estimate: TargetEstimate,
    vehicle: VehicleState,
    servo: ServoSettings,
    settings: TargetFixSettings | None = None,
) -> TargetFix | None:
    """Return the target's position and velocity, None where they cannot be told.

    The range is where the line of sight meets level ground (`range_from: ground`, or no
    `target_size_m`), else the one by size, but not beyond the ground: a box that has shrunk onto a
    part of the target looks far away. The estimate's covariance and the settings' are carried over
    to first order.

    Args:
        estimate: in the world's frame; one in the body's tells no place.
        vehicle: with a position that is not older than half a second.
        servo: says what the range is taken from.
        settings: what else is uncertain.
    """
    position = vehicle.position
    age_s = vehicle.position_age_s(estimate.time_s)
    if position is None or estimate.frame is SightFrame.BODY or not abs(age_s) <= _STALE_S:
        return None
    s, now = settings or TargetFixSettings(), _moved(position, estimate.time_s)
    ground = _by_ground(estimate, now, servo, s) if _meets_ground(estimate, now, servo) else None
    found = ground
    if servo.target_size_m is not None and (servo.range_from is RangeFrom.SIZE or ground is None):
        found = _by_size(estimate, now, servo, s)
        if ground is not None and _is_below(found, ground):
            found = ground
    if found is None:
        return None
    place, inputs, noise = found
    answer = place(inputs)
    jacobian = _jacobian(place, inputs)
    covariance = jacobian @ noise @ jacobian.T
    own = [s.position_m] * 3 + [s.velocity_m_s] * 3
    covariance += np.diag(np.square(own))
    if not np.all(np.isfinite(covariance)):
        return None
    offset = answer[:3] - (now.north_m, now.east_m, now.down_m)
    p, v = answer[:3].tolist(), answer[3:].tolist()
    return TargetFix(
        estimate.time_s,
        (p[0], p[1], p[2]),
        (v[0], v[1], v[2]),
        covariance,
        float(np.linalg.norm(offset)),
    )


_Place = Callable[[Vector], Vector]
"""From the uncertain numbers to position and velocity."""

_Found = tuple[_Place, Vector, Vector]
"""With those numbers, and their covariance."""


def _is_below(found: _Found, ground: _Found) -> bool:
    """Whether a target would lie below the ground; down is the third number."""
    return bool(found[0](found[1])[2] > ground[0](ground[1])[2])


def _by_size(
    estimate: TargetEstimate, own: LocalPosition, servo: ServoSettings, s: TargetFixSettings
) -> _Found:
    """Inputs: azimuth, elevation, log scale, their rates."""
    size_m = servo.target_size_m or servo.distance_m

    def place(x: Vector) -> Vector:
        range_m = size_m * math.exp(-x[2])
        return _placed(x[0], x[1], range_m, x[3], x[4], -range_m * x[5], own, estimate.frame)

    noise = np.array(estimate.covariance)
    noise[2, 2] += s.size_share**2
    return place, _numbers(estimate), _with_attitude(noise, estimate, s)


def _by_ground(
    estimate: TargetEstimate, own: LocalPosition, servo: ServoSettings, s: TargetFixSettings
) -> _Found:
    """Inputs: azimuth, elevation, height above the target's middle, the angles' rates, climb.

    The target is taken to move on level ground.
    """
    above_m = own.height_m - servo.target_middle_m

    def place(x: Vector) -> Vector:
        direction = from_sight(LineOfSight(x[0], x[1]), estimate.frame)
        range_m = x[2] / direction[2]
        ahead = from_sight(LineOfSight(x[0] + _STEP * x[3], x[1] + _STEP * x[4]), estimate.frame)
        range_rate = ((x[2] + _STEP * x[5]) / ahead[2] - range_m) / _STEP
        return _placed(x[0], x[1], range_m, x[3], x[4], range_rate, own, estimate.frame)

    inputs = _numbers(estimate)
    inputs[2], inputs[5] = above_m, -own.down_m_s
    noise = np.array(estimate.covariance)
    noise[[2, 5], :] = noise[:, [2, 5]] = 0.0
    noise[2, 2], noise[5, 5] = s.height_m**2, s.velocity_m_s**2
    return place, inputs, _with_attitude(noise, estimate, s)


def _numbers(estimate: TargetEstimate) -> Vector:
    return np.array(
        [
            estimate.azimuth_rad,
            estimate.elevation_rad,
            estimate.log_scale,
            estimate.azimuth_rate_rad_s,
            estimate.elevation_rate_rad_s,
            estimate.log_scale_rate_s,
        ]
    )


def _with_attitude(noise: Vector, estimate: TargetEstimate, s: TargetFixSettings) -> Vector:
    variance = math.radians(s.attitude_deg) ** 2
    level = max(math.cos(estimate.elevation_rad), 0.1)
    noise[0, 0] += variance / level**2
    noise[1, 1] += variance
    return noise


def _placed(
    azimuth: float,
    elevation: float,
    range_m: float,
    azimuth_rate: float,
    elevation_rate: float,
    range_rate: float,
    own: LocalPosition,
    frame: SightFrame,
) -> Vector:
    """Return position and velocity of what is seen there from our own place."""
    direction = from_sight(LineOfSight(azimuth, elevation), frame)
    turned = from_sight(
        LineOfSight(azimuth + _STEP * azimuth_rate, elevation + _STEP * elevation_rate), frame
    )
    position = np.array((own.north_m, own.east_m, own.down_m)) + range_m * direction
    turning = (turned - direction) / _STEP
    velocity = np.array((own.north_m_s, own.east_m_s, own.down_m_s))
    return np.concatenate((position, velocity + range_rate * direction + range_m * turning))


def _meets_ground(estimate: TargetEstimate, own: LocalPosition, servo: ServoSettings) -> bool:
    above_m = own.height_m - servo.target_middle_m
    return above_m >= _LOWEST_M and estimate.height_angle_rad <= -_FLATTEST_RAD


def _moved(position: LocalPosition, time_s: float) -> LocalPosition:
    """Return where the vehicle is at a time near the position's own."""
    ahead_s = time_s - position.time_s
    return LocalPosition(
        position.north_m + ahead_s * position.north_m_s,
        position.east_m + ahead_s * position.east_m_s,
        position.down_m + ahead_s * position.down_m_s,
        position.north_m_s,
        position.east_m_s,
        position.down_m_s,
        time_s,
    )


def _jacobian(place: _Place, inputs: Vector) -> Vector:
    columns = []
    for index in range(len(inputs)):
        step = np.zeros(len(inputs))
        step[index] = 1e-4
        columns.append((place(inputs + step) - place(inputs - step)) / 2e-4)
    return np.stack(columns, axis=1)


def _largest_deviation(covariance: Vector) -> float:
    return math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))
