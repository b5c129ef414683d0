"""What the servo sees of a pursuit: distance, errors, and how the target moves."""

from __future__ import annotations

import math

from follower_control.estimate import TargetEstimate
from follower_control.ground_range import ranged_by_ground
from follower_control.reference import Reference
from follower_control.relative_motion import (
    OLD_S,
    azimuth_of,
    offset_rate,
    own_velocity,
    speed_towards,
)
from follower_control.servo_errors import ServoErrors
from follower_control.servo_settings import Mode, RangeFrom, ServoSettings
from follower_control.target_motion import TargetMotion
from follower_control.target_speed import TargetSpeed
from follower_control.vehicle import VehicleState
from follower_vision.lineofsight import wrap_angle

_LOG_TEN = math.log(10)
_STRAIGHT_DOWN_RAD = -math.pi / 2


class PursuitSight:
    """Compares estimates with what is wanted, and keeps the target's size and motion.

    Args:
        settings: of the servo.
        reference: what is wanted now.

    Attributes:
        target: where the target goes.
    """

    def __init__(self, settings: ServoSettings, reference: Reference) -> None:
        self._settings = settings
        self._reference = reference
        self._speed = TargetSpeed(settings.target_speed_filter_s, settings.own_speed_lag_s)
        self.target = TargetMotion(settings.course_filter_s, settings.own_speed_lag_s)
        self.start()

    def start(self) -> None:
        """Begin a pursuit; without a `target_size_m`, the size that `hold_size` sees will count."""
        s = self._settings
        self._wanted_log_scale: float | None = None
        if s.target_size_m is not None:
            self._wanted_log_scale = math.log(s.target_size_m / s.distance_m)
        self.target.start()
        self.pause()

    def change(self, settings: ServoSettings) -> None:
        """Go on by other settings; a size that is held stays as far away as it was."""
        before, self._settings = self._settings, settings
        if settings.target_size_m is not None:
            self._wanted_log_scale = math.log(settings.target_size_m / settings.distance_m)
        elif self._wanted_log_scale is not None:
            self._wanted_log_scale += math.log(before.distance_m / settings.distance_m)
        self._speed.change(settings.target_speed_filter_s, settings.own_speed_lag_s)
        self.target.change(settings.course_filter_s, settings.own_speed_lag_s)

    def pause(self) -> None:
        """Forget the target's velocity."""
        self._speed.reset()
        self.target.reset()

    def hold_size(self, estimate: TargetEstimate) -> None:
        """Take this size for the wanted one, unless there is one."""
        if self._wanted_log_scale is None:
            self._wanted_log_scale = estimate.log_scale

    def ranged(self, estimate: TargetEstimate, vehicle: VehicleState) -> TargetEstimate:
        """Put the range by the ground into the place of the one by size, if that is wanted."""
        position = vehicle.position
        fresh = vehicle.position_age_s(estimate.time_s) <= OLD_S
        if self._settings.range_from is RangeFrom.SIZE or position is None or not fresh:
            return estimate
        size_m = self._settings.target_size_m or self._settings.distance_m
        self._wanted_log_scale = math.log(size_m / self._settings.distance_m)
        above_m = position.height_m - self._settings.target_middle_m
        return ranged_by_ground(estimate, size_m, above_m, -position.down_m_s)

    def errors(
        self,
        estimate: TargetEstimate,
        yaw: float,
        vehicle: VehicleState,
        mode: Mode,
        interval_s: float,
    ) -> ServoErrors:
        """Return how far the pursuit is from what is wanted, `interval_s` after the last time."""
        range_m = self.range_m(estimate)
        self._watch_motion(estimate, vehicle, range_m, interval_s)
        wanted = self._reference.elevation_rad
        wanted = _STRAIGHT_DOWN_RAD if mode is Mode.OVERHEAD else wanted
        return ServoErrors(
            azimuth_rad=wrap_angle(azimuth_of(estimate) - yaw),
            elevation_rad=estimate.height_angle_rad - wanted,
            log_range=math.log(range_m / self._reference.distance_m),
            range_m=range_m,
            target_speed_m_s=self._seen_speed(estimate, vehicle, range_m, interval_s),
        )

    def _watch_motion(
        self, estimate: TargetEstimate, vehicle: VehicleState, range_m: float, interval_s: float
    ) -> None:
        own = own_velocity(estimate, vehicle)
        if own is None:
            self.target.reset()
        else:
            self.target.update(own, offset_rate(estimate, range_m), interval_s)

    def _seen_speed(
        self, estimate: TargetEstimate, vehicle: VehicleState, range_m: float, interval_s: float
    ) -> float:
        own_speed = speed_towards(estimate, vehicle)
        if own_speed is None:
            self._speed.reset()
            return 0.0
        range_rate = -range_m * estimate.log_scale_rate_s
        return self._speed.update(own_speed, range_rate, interval_s)

    def range_m(self, estimate: TargetEstimate) -> float:
        """Return the distance to the target, within a factor of ten of the wanted one."""
        wanted = estimate.log_scale if self._wanted_log_scale is None else self._wanted_log_scale
        return self._settings.distance_m * math.exp(_clip(wanted - estimate.log_scale, _LOG_TEN))


def _clip(value: float, largest: float) -> float:
    return min(max(value, -largest), largest)
