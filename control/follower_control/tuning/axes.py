"""The follow loops of the servo, axis by axis, as linear systems about steady following.

Left out: limits, the slowing down for a target off-axis, and what one axis does to another.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum

from follower_control.envelope_settings import EnvelopeSettings
from follower_control.estimator import EstimatorSettings
from follower_control.pid import PidSettings
from follower_control.pursuit_sight import ACROSS, ALONG, ALONG_GROUND
from follower_control.servo_settings import RangeFrom, ServoSettings
from follower_control.tuning.axis_loop import AxisLoop
from follower_control.tuning.conditions import Conditions
from follower_control.tuning.rational import ONE, Rational, integrator
from follower_control.tuning.response_model import ResponseModel, VehicleModel
from follower_control.tuning.steady_filter import SteadyFilter


class Axis(StrEnum):
    """The loops of chasing; each has its section of gains in `servo`."""

    AZIMUTH = "azimuth"
    ELEVATION = "elevation"
    RANGE = "range"


@dataclass(frozen=True, slots=True)
class Follower:
    """All settings that the loops depend on."""

    servo: ServoSettings
    estimator: EstimatorSettings
    envelope: EnvelopeSettings

    def gains(self, axis: Axis) -> PidSettings:
        """Return one loop's gains."""
        return {
            Axis.AZIMUTH: self.servo.azimuth,
            Axis.ELEVATION: self.servo.elevation,
            Axis.RANGE: self.servo.range,
        }[axis]


def axis_loop(
    axis: Axis,
    gains: PidSettings,
    vehicle: VehicleModel,
    follower: Follower,
    conditions: Conditions,
) -> AxisLoop:
    """Return one axis with these gains, which need not be those of the settings."""
    build = {Axis.AZIMUTH: _azimuth, Axis.ELEVATION: _elevation, Axis.RANGE: _range}[axis]
    return build(gains, vehicle, follower, conditions)


def pid(gains: PidSettings) -> Rational:
    """Return the loop from measurement to output, derivative and all."""
    filtered = Rational((gains.kd, 0.0), (gains.derivative_filter_s, 1.0))
    return _without_derivative(gains) + filtered if gains.kd else _without_derivative(gains)


def _without_derivative(gains: PidSettings) -> Rational:
    return Rational((gains.kp, gains.ki), (1.0, 0.0)) if gains.ki else Rational((gains.kp,))


@dataclass(frozen=True, slots=True)
class _Sight:
    """From where the target is to what is known of it: the estimator, then the place it is kept at.

    Our own motion is known at once, by telemetry. But the estimator follows the target as seen from
    us, and takes some time to see what we did to that; what it has not seen yet of our own motion
    looks like the target's.
    """

    estimator: SteadyFilter
    place: SteadyFilter

    def value(self, age_s: float) -> Rational:
        """Return from the quantity, seen `age_s` late, to the one for now."""
        return self.estimator.value(0.0) * self.place.value(age_s)

    def rate(self, age_s: float) -> Rational:
        """Return from the quantity, seen `age_s` late, to its rate."""
        return self.estimator.value(0.0) * self.place.rate(age_s)

    @property
    def missed(self) -> Rational:
        """From what our own motion did to the quantity to what of it is taken for the target's."""
        return self.estimator.missed

    @property
    def noise(self) -> float:
        """Standard deviation of one sighting."""
        return self.estimator.noise


def _azimuth(
    gains: PidSettings, vehicle: VehicleModel, follower: Follower, conditions: Conditions
) -> AxisLoop:
    """Yaw is known from telemetry at once: the camera's delay stands before the target alone.

    A wrong stamp lets our own turning look like the target's for as long as it is wrong.
    """
    delays = conditions.delays
    sight = _direction_sight(follower, conditions, Axis.AZIMUTH)
    controller = pid(gains)
    seen = controller * sight.value(0.0) + sight.rate(0.0)
    own: tuple[Rational, ...] = (controller,)
    if delays.stamp_error_s:
        late = delays.sight_s
        own = (*own, seen.scaled(-1.0).delayed(late - delays.stamp_error_s), seen.delayed(late))
    return AxisLoop(
        Axis.AZIMUTH,
        "rad",
        _plant(vehicle.yaw_rate, conditions, 0.0),
        integrator(),
        own,
        controller * sight.value(delays.sight_s) + sight.rate(delays.sight_s),
        (),
        _without_derivative(gains),
        sight.noise,
        delays.frame_interval_s,
        "rad/s",
        1.0,
    )


def _elevation(
    gains: PidSettings, vehicle: VehicleModel, follower: Follower, conditions: Conditions
) -> AxisLoop:
    sight = _direction_sight(follower, conditions, Axis.ELEVATION)
    seen = pid(gains) * sight.place.value(conditions.delays.sight_s)
    return AxisLoop(
        Axis.ELEVATION,
        "rad",
        _plant(vehicle.down, conditions, _smoothing_s(follower, conditions)),
        integrator(math.cos(conditions.elevation_rad)),
        (pid(gains), (seen * sight.missed).scaled(-1.0)),
        pid(gains) * sight.value(conditions.delays.sight_s),
        (),
        _without_derivative(gains),
        sight.noise,
        conditions.delays.frame_interval_s,
        "m/s",
        conditions.range_m,
    )


def _range(
    gains: PidSettings, vehicle: VehicleModel, follower: Follower, conditions: Conditions
) -> AxisLoop:
    """The target's speed is fed forward; our own is no part of it, but for what is missed.

    With the climb that keeps the elevation the vehicle flies along the line of sight.
    """
    servo, delays = follower.servo, conditions.delays
    sight = _range_sight(follower, conditions)
    level, scale = math.cos(conditions.elevation_rad), servo.distance_m / conditions.range_m
    if servo.schedule_range:
        share = 1 / scale
        gains = replace(gains, kp=share * gains.kp, ki=share * gains.ki, kd=share * gains.kd)
    # The speed is horizontal, the range is along the line of sight.
    value, rate = (f(delays.sight_s) for f in (sight.place.value, sight.place.rate))
    seen = pid(gains) * value + rate.scaled(1.0 / (scale * level))
    own = pid(gains) * value + rate.scaled(level / scale)
    return AxisLoop(
        Axis.RANGE,
        "log",
        _plant(vehicle.forward, conditions, _smoothing_s(follower, conditions)),
        integrator(scale * level if servo.hold_height else scale / level),
        (pid(gains), (own * sight.missed).scaled(-1.0)),
        seen * sight.estimator.value(0.0),
        (),
        _without_derivative(gains),
        sight.noise,
        delays.frame_interval_s,
        "m/s",
        servo.distance_m,
    )


def _plant(model: ResponseModel, conditions: Conditions, smoothing_s: float) -> Rational:
    """Return the vehicle behind the envelope; a setpoint stays for an interval."""
    delays = conditions.delays
    held_s = delays.control_interval_s / 2 + smoothing_s + delays.extra_s
    return (ONE * model.linear).delayed(held_s)


def _smoothing_s(follower: Follower, conditions: Conditions) -> float:
    """Return by how much the envelope's jerk limit delays a velocity that changes steadily."""
    jerk = follower.envelope.max_jerk_m_s3
    return conditions.delays.control_interval_s + conditions.acceleration_m_s2 / (2 * jerk)


def _direction_filter(follower: Follower, conditions: Conditions, axis: Axis) -> SteadyFilter:
    s = follower.estimator
    share = s.direction_noise_share * conditions.size_m / conditions.range_m
    noise = math.hypot(math.radians(s.direction_noise_deg), share)
    if axis is Axis.AZIMUTH:
        noise /= max(math.cos(conditions.elevation_rad), 0.01)
        acceleration = math.radians(s.azimuth_acceleration_deg_s2)
    else:
        acceleration = math.radians(s.elevation_acceleration_deg_s2)
    return SteadyFilter.of(acceleration, noise, conditions.delays.frame_interval_s)


def _direction_sight(follower: Follower, conditions: Conditions, axis: Axis) -> _Sight:
    estimator = _direction_filter(follower, conditions, axis)
    return _Sight(estimator, _place_filter(ACROSS, follower, conditions))


def _range_sight(follower: Follower, conditions: Conditions) -> _Sight:
    """Return the sight of the log scale, or of the elevation where the ground tells the range."""
    s, interval_s = follower.estimator, conditions.delays.frame_interval_s
    if follower.servo.range_from is RangeFrom.SIZE:
        scale = SteadyFilter.of(s.log_scale_acceleration_s2, s.log_scale_noise, interval_s)
        return _Sight(scale, _place_filter(ALONG, follower, conditions))
    direction = _direction_filter(follower, conditions, Axis.ELEVATION)
    slope = 1 / max(abs(math.tan(conditions.elevation_rad)), 0.05)
    estimator = SteadyFilter(
        direction.rate_gain_per_s2, direction.gain_per_s, slope * direction.noise, interval_s
    )
    return _Sight(estimator, _place_filter(ALONG_GROUND, follower, conditions))


def _place_filter(share: float, follower: Follower, conditions: Conditions) -> SteadyFilter:
    """Return the filter on the target's place, over the distance."""
    servo = follower.servo
    most, across = servo.target_acceleration_m_s2, servo.target_acceleration_across_m_s2
    if share == ACROSS and across is not None:
        most = across
    acceleration = most / conditions.range_m
    return SteadyFilter.of(acceleration, share, conditions.delays.frame_interval_s)
