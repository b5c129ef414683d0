"""The follow loops of the servo, axis by axis, as linear systems about steady following.

Left out: limits, the slowing down for a target off-axis, and what one axis does to another, as
when the vehicle pitches to speed up and the frames' stamps are wrong. The range loop is that after
a moving target while the vehicle stays behind what was sent, for which the servo asks for more: the
least of its margins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.linalg import solve_discrete_are

from follower_control.envelope.settings import EnvelopeSettings
from follower_control.servo.pid import PidSettings
from follower_control.servo.pursuit_state import ACROSS, ALONG, ALONG_GROUND
from follower_control.servo.servo import IN_VAIN_S
from follower_control.servo.settings import RangeFrom, ServoSettings
from follower_control.target.settings import EstimatorSettings
from follower_control.tuning.axis_loop import AxisLoop, Conditions, LoopDelays
from follower_control.tuning.rational import ONE, Rational, integrator
from follower_control.tuning.response_model import ResponseModel, VehicleModel


@dataclass(frozen=True, slots=True)
class SteadyFilter:
    """A constant-velocity filter with constant gains, as if it ran without pauses.

    Its poles are those of the sampled filter at its frame rate; a target that moves steadily is
    followed without error, as the sampled one does.

    Attributes:
        rate_gain_per_s2: k2 of the denominator s² + k1 s + k2.
        gain_per_s: k1.
        noise: standard deviation of what it is fed.
        interval_s: between two frames.
    """

    rate_gain_per_s2: float
    gain_per_s: float
    noise: float
    interval_s: float

    @classmethod
    def of(cls, acceleration: float, noise: float, interval_s: float) -> SteadyFilter:
        """Settle the filter.

        Args:
            acceleration: root of the spectral density of the white acceleration, per sqrt(Hz).
            noise: standard deviation of one measurement.
            interval_s: between two frames.

        Raises:
            ValueError: one of them is not above 0.
        """
        if min(acceleration, noise, interval_s) <= 0:
            raise ValueError("a filter has acceleration, noise and interval above 0")
        t, q = interval_s, acceleration**2
        move = np.array([[1.0, t], [0.0, 1.0]])
        drive = q * np.array([[t**3 / 3, t**2 / 2], [t**2 / 2, t]])
        seen = np.array([[1.0, 0.0]])
        before = solve_discrete_are(move.T, seen.T, drive, np.array([[noise**2]]))
        gain = before @ seen.T / (before[0, 0] + noise**2)
        poles = np.log(np.linalg.eigvals((np.eye(2) - gain @ seen) @ move).astype(complex)) / t
        return cls(float(np.prod(poles).real), float(-np.sum(poles).real), noise, t)

    def value(self, age_s: float) -> Rational:
        """Return from the measured value, `age_s` seconds old, to the one predicted to now."""
        k1, k2 = self.gain_per_s, self.rate_gain_per_s2
        return Rational((k1 + age_s * k2, k2), (1.0, k1, k2), age_s)

    @property
    def missed(self) -> Rational:
        """From the measured value to what the filter does not follow of it: one less `value`."""
        return Rational((1.0, 0.0, 0.0), (1.0, self.gain_per_s, self.rate_gain_per_s2))

    def rate(self, age_s: float) -> Rational:
        """Return from the measured value, `age_s` seconds old, to the rate."""
        k1, k2 = self.gain_per_s, self.rate_gain_per_s2
        return Rational((k2, 0.0), (1.0, k1, k2), age_s)


class Axis(StrEnum):
    """The loops of chasing; each has its section of gains in `servo`."""

    AZIMUTH = "azimuth"
    ELEVATION = "elevation"
    RANGE = "range"


@dataclass(frozen=True, slots=True)
class LoopSettings:
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
    follower: LoopSettings,
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
class _TargetFilters:
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


def _azimuth(
    gains: PidSettings, vehicle: VehicleModel, follower: LoopSettings, conditions: Conditions
) -> AxisLoop:
    """Yaw is known from telemetry at once: the camera's delay stands before the target alone."""
    delays = conditions.delays
    filters = _direction_filters(follower, conditions, Axis.AZIMUTH)
    controller = pid(gains)
    seen = controller * filters.value(0.0) + filters.rate(0.0)
    return AxisLoop(
        Axis.AZIMUTH,
        "rad",
        _plant(vehicle.yaw_rate, conditions, 0.0),
        integrator(),
        (controller, *_mistaken(seen, delays)),
        controller * filters.value(delays.image_age_s) + filters.rate(delays.image_age_s),
        _without_derivative(gains),
        filters.estimator.noise,
        delays.frame_interval_s,
        1.0,
    )


def _elevation(
    gains: PidSettings, vehicle: VehicleModel, follower: LoopSettings, conditions: Conditions
) -> AxisLoop:
    filters, delays = _direction_filters(follower, conditions, Axis.ELEVATION), conditions.delays
    controller = pid(gains)
    seen = controller * filters.place.value(delays.image_age_s)
    return AxisLoop(
        Axis.ELEVATION,
        "rad",
        _plant(vehicle.down, conditions, _smoothing_s(follower, conditions)),
        integrator(math.cos(conditions.elevation_rad)),
        (
            controller,
            (seen * filters.estimator.missed).scaled(-1.0),
            *_mistaken(controller * filters.value(0.0), delays),
        ),
        controller * filters.value(delays.image_age_s),
        _without_derivative(gains),
        filters.estimator.noise,
        delays.frame_interval_s,
        conditions.range_m,
    )


def _range(
    gains: PidSettings, vehicle: VehicleModel, follower: LoopSettings, conditions: Conditions
) -> AxisLoop:
    """The target's speed is fed forward; our own is no part of it, but for what is missed.

    With the climb that keeps the elevation the vehicle flies along the line of sight.
    """
    servo, delays = follower.servo, conditions.delays
    filters = _range_filters(follower, conditions)
    level, scale = math.cos(conditions.elevation_rad), servo.distance_m / conditions.range_m
    if servo.schedule_range:
        share = 1 / scale
        gains = replace(gains, kp=share * gains.kp, ki=share * gains.ki, kd=share * gains.kd)
    # Speeds are horizontal, the range is along the line of sight.
    moved = scale * level if servo.hold_height else scale / level
    value, rate = (f(delays.image_age_s) for f in (filters.place.value, filters.place.rate))
    seen = pid(gains) * value + rate.scaled(1.0 / moved)
    own = pid(gains) * value + rate.scaled(level / scale)
    at_once = pid(gains) * filters.value(0.0) + filters.rate(0.0).scaled(level / scale)
    return AxisLoop(
        Axis.RANGE,
        "log",
        _plant(vehicle.forward, conditions, _smoothing_s(follower, conditions)),
        integrator(moved),
        (
            pid(gains),
            (own * filters.estimator.missed).scaled(-1.0),
            *_mistaken(at_once, delays),
        ),
        seen * filters.estimator.value(0.0),
        _without_derivative(gains),
        filters.estimator.noise,
        delays.frame_interval_s,
        servo.distance_m,
        Rational((1.0,), (IN_VAIN_S, 1.0)),
    )


def _mistaken(seen: Rational, delays: LoopDelays) -> tuple[Rational, ...]:
    """Return what is made of our own motion that a wrong stamp lets look like the target's.

    Args:
        seen: from what the target did, seen at once, to the loop's output.
        delays: with the stamp's error.
    """
    if not delays.stamp_error_s:
        return ()
    late_s = delays.image_age_s
    return seen.scaled(-1.0).delayed(late_s - delays.stamp_error_s), seen.delayed(late_s)


def _plant(model: ResponseModel, conditions: Conditions, smoothing_s: float) -> Rational:
    """Return the vehicle behind the envelope; a setpoint stays for an interval."""
    delays = conditions.delays
    held_s = delays.control_interval_s / 2 + smoothing_s + delays.extra_s
    return (ONE * model.linear).delayed(held_s)


def _smoothing_s(follower: LoopSettings, conditions: Conditions) -> float:
    """Return by how much the envelope's jerk limit delays a velocity that changes steadily."""
    jerk = follower.envelope.max_jerk_m_s3
    return conditions.delays.control_interval_s + conditions.acceleration_m_s2 / (2 * jerk)


def _direction_filter(follower: LoopSettings, conditions: Conditions, axis: Axis) -> SteadyFilter:
    s = follower.estimator
    share = s.direction_noise_share * conditions.size_m / conditions.range_m
    noise = math.hypot(math.radians(s.direction_noise_deg), share)
    if axis is Axis.AZIMUTH:
        noise /= max(math.cos(conditions.elevation_rad), 0.01)
        acceleration = math.radians(s.azimuth_acceleration_deg_s2)
    else:
        acceleration = math.radians(s.elevation_acceleration_deg_s2)
    return SteadyFilter.of(acceleration, noise, conditions.delays.frame_interval_s)


def _direction_filters(
    follower: LoopSettings, conditions: Conditions, axis: Axis
) -> _TargetFilters:
    estimator = _direction_filter(follower, conditions, axis)
    return _TargetFilters(estimator, _place_filter(ACROSS, follower, conditions))


def _range_filters(follower: LoopSettings, conditions: Conditions) -> _TargetFilters:
    """Return what is known of the log scale, or of the elevation for a range by the ground."""
    s, interval_s = follower.estimator, conditions.delays.frame_interval_s
    if follower.servo.range_from is RangeFrom.SIZE:
        scale = SteadyFilter.of(s.log_scale_acceleration_s2, s.log_scale_noise, interval_s)
        return _TargetFilters(scale, _place_filter(ALONG, follower, conditions))
    direction = _direction_filter(follower, conditions, Axis.ELEVATION)
    slope = 1 / max(abs(math.tan(conditions.elevation_rad)), 0.05)
    estimator = SteadyFilter(
        direction.rate_gain_per_s2, direction.gain_per_s, slope * direction.noise, interval_s
    )
    return _TargetFilters(estimator, _place_filter(ALONG_GROUND, follower, conditions))


def _place_filter(share: float, follower: LoopSettings, conditions: Conditions) -> SteadyFilter:
    """Return the filter on the target's place, over the distance."""
    servo = follower.servo
    most, across = servo.target_acceleration_m_s2, servo.target_acceleration_across_m_s2
    if share == ACROSS and across is not None:
        most = across
    acceleration = most / conditions.range_m
    return SteadyFilter.of(acceleration, share, conditions.delays.frame_interval_s)
