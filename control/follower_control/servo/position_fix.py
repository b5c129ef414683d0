"""Where the target is in the world, and how fast it goes, with how sure that is."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from follower_control.common.small_matrix import largest_eigenvalue, length, product
from follower_control.servo.settings import RangeFrom, ServoSettings
from follower_control.target.estimate import TargetEstimate
from follower_control.target.observation import BearingFrame, to_vector
from follower_control.vehicle.state import LocalPosition, VehicleState
from follower_vision.geometry.camera_model import Vector
from follower_vision.geometry.line_of_sight import LineOfSight

_STALE_S = 0.5
_LOWEST_M = 1.0
_FLATTEST_RAD = math.radians(5)
_STEP = 1e-5


class PositionNoise(NamedTuple):
    """What the estimate's covariance does not know of, as standard deviations.

    Attributes:
        attitude_deg: of the attitude with which a line of sight was turned, and of the mount.
        size_share: of the target's size as seen, as a share of it: it differs from side to side.
        height_m: of our height above the ground on which the target stands.
        position_m: of our own position, along each axis.
        velocity_m_s: of our own velocity, likewise.
    """

    attitude_deg: float = 1.0
    size_share: float = 0.2
    height_m: float = 0.5
    position_m: float = 0.5
    velocity_m_s: float = 0.3


USUAL_NOISE = PositionNoise()


@dataclass(frozen=True, slots=True, eq=False)
class TargetPosition:
    """The target in the world.

    Attributes:
        time_s: the time for which this holds.
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
        """Standard deviation of the horizontal position along its worse axis, metres."""
        return _largest_deviation(self.covariance[:2, :2])

    @property
    def vertical_m(self) -> float:
        """Standard deviation of the height, metres."""
        return math.sqrt(max(float(self.covariance[2, 2]), 0.0))

    @property
    def speed_m_s(self) -> float:
        """Standard deviation of the velocity along its worst axis, m/s."""
        return _largest_deviation(self.covariance[3:, 3:])


def target_fix(
    estimate: TargetEstimate,
    vehicle: VehicleState,
    servo: ServoSettings,
    noise: PositionNoise = USUAL_NOISE,
) -> TargetPosition | None:
    """Return the target's position and velocity, None where they are not known.

    The range is where the line of sight meets level ground (`range_from: ground`, or no
    `target_size_m`), else the one by size, but not beyond the ground: a box that has shrunk onto a
    part of the target looks far away. The estimate's covariance and `noise` are carried over to
    first order.

    Args:
        estimate: in the world's frame; one in the body's gives no position.
        vehicle: with a position that is not older than half a second.
        servo: says what the range is taken from.
        noise: what else is uncertain.
    """
    position = vehicle.position
    age_s = vehicle.position_age_s(estimate.time_s)
    if position is None or estimate.frame is BearingFrame.BODY or not abs(age_s) <= _STALE_S:
        return None
    s, now = noise, _moved(position, estimate.time_s)
    measured_m = vehicle.fresh_clearance_m(estimate.time_s)
    above_m = (now.height_m if measured_m is None else measured_m) - servo.target_middle_m
    meets = above_m >= _LOWEST_M and estimate.height_angle_rad <= -_FLATTEST_RAD
    ground = _by_ground(estimate, now, above_m, s) if meets else None
    found = ground
    if servo.target_size_m is not None and (servo.range_from is RangeFrom.SIZE or ground is None):
        found = _by_size(estimate, now, servo, s)
        # Each is (place, inputs, covariance): the target does not lie below the ground.
        if ground is not None and found[0](found[1])[2] > ground[0](ground[1])[2]:
            found = ground
    if found is None:
        return None
    place, inputs, covariance = found
    answer = place(inputs)
    jacobian = _jacobian(place, inputs)
    covariance = product(product(jacobian, covariance), jacobian.T)
    own = [s.position_m] * 3 + [s.velocity_m_s] * 3
    covariance += np.diag(np.square(own))
    if not np.all(np.isfinite(covariance)):
        return None
    offset = answer[:3] - (now.north_m, now.east_m, now.down_m)
    p, v = answer[:3].tolist(), answer[3:].tolist()
    return TargetPosition(
        estimate.time_s,
        (p[0], p[1], p[2]),
        (v[0], v[1], v[2]),
        covariance,
        length(offset),
    )


_Place = Callable[[Vector], Vector]
"""From the uncertain numbers to position and velocity."""

_Found = tuple[_Place, Vector, Vector]
"""With those numbers, and their covariance."""


def _by_size(
    estimate: TargetEstimate, own: LocalPosition, servo: ServoSettings, s: PositionNoise
) -> _Found:
    """Inputs: azimuth, elevation, log scale, their rates."""
    size_m = servo.target_size_m or servo.distance_m

    def place(x: Vector) -> Vector:
        range_m = size_m * math.exp(-x[2])
        return _placed(x, range_m, -range_m * x[5], own, estimate.frame)

    noise = np.array(estimate.covariance)
    noise[2, 2] += s.size_share**2
    return place, np.array(estimate.values), _with_attitude(noise, estimate, s)


def _by_ground(
    estimate: TargetEstimate, own: LocalPosition, above_m: float, s: PositionNoise
) -> _Found:
    """Inputs: azimuth, elevation, height above the target's middle, the angles' rates, climb.

    The target is taken to move on level ground.
    """

    def place(x: Vector) -> Vector:
        direction, ahead = _directions(x, estimate.frame)
        range_m = x[2] / direction[2]
        range_rate = ((x[2] + _STEP * x[5]) / ahead[2] - range_m) / _STEP
        return _placed(x, range_m, range_rate, own, estimate.frame)

    inputs = np.array(estimate.values)
    inputs[2], inputs[5] = above_m, -own.down_m_s
    noise = np.array(estimate.covariance)
    noise[[2, 5], :] = noise[:, [2, 5]] = 0.0
    noise[2, 2], noise[5, 5] = s.height_m**2, s.velocity_m_s**2
    return place, inputs, _with_attitude(noise, estimate, s)


def _with_attitude(noise: Vector, estimate: TargetEstimate, s: PositionNoise) -> Vector:
    variance = math.radians(s.attitude_deg) ** 2
    level = max(math.cos(estimate.elevation_rad), 0.1)
    noise[0, 0] += variance / level**2
    noise[1, 1] += variance
    return noise


def _directions(x: Vector, frame: BearingFrame) -> tuple[Vector, Vector]:
    """Return the unit vectors, (3,), along the line of sight: now, and `_STEP` seconds later."""
    later = LineOfSight(x[0] + _STEP * x[3], x[1] + _STEP * x[4])
    return to_vector(LineOfSight(x[0], x[1]), frame), to_vector(later, frame)


def _placed(
    x: Vector, range_m: float, range_rate_m_s: float, own: LocalPosition, frame: BearingFrame
) -> Vector:
    """Return position and velocity, (6,) NED, of what is seen there from our own position."""
    direction, later = _directions(x, frame)
    position = np.array(own.numbers[:3]) + range_m * direction
    turning = (later - direction) / _STEP
    velocity = np.array(own.numbers[3:]) + range_rate_m_s * direction
    return np.concatenate((position, velocity + range_m * turning))


def _moved(position: LocalPosition, time_s: float) -> LocalPosition:
    """Return where the vehicle is at a time near the position's own."""
    ahead_s = time_s - position.time_s
    return replace(
        position,
        north_m=position.north_m + ahead_s * position.north_m_s,
        east_m=position.east_m + ahead_s * position.east_m_s,
        down_m=position.down_m + ahead_s * position.down_m_s,
        time_s=time_s,
    )


def _jacobian(place: _Place, inputs: Vector) -> Vector:
    columns = []
    for index in range(len(inputs)):
        step = np.zeros(len(inputs))
        step[index] = 1e-4
        columns.append((place(inputs + step) - place(inputs - step)) / 2e-4)
    return np.stack(columns, axis=1)


def _largest_deviation(covariance: Vector) -> float:
    return math.sqrt(max(largest_eigenvalue(covariance), 0.0))
