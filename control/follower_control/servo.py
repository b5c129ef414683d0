"""The law that turns an estimate of the target into a velocity setpoint."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, ClassVar

from follower_control.attitude_history import turned_on
from follower_control.estimate import TargetEstimate
from follower_control.nudge import Nudge
from follower_control.pid import Pid, PidSettings
from follower_control.reference import Reference
from follower_control.servo_errors import ServoErrors
from follower_control.setpoint import HOLD, VelocitySetpoint
from follower_control.sighting import SightFrame
from follower_control.target_speed import TargetSpeed
from follower_control.vehicle import VehicleState
from follower_vision.lineofsight import wrap_angle

PAUSE_S = 0.5
"""Older telemetry is not used; after a longer pause the loops begin anew."""

LOG_TEN = math.log(10)
_STEEPEST_RAD = math.radians(60)


class Mode(StrEnum):
    """What the servo does about the target."""

    CHASE = "chase"
    """Turn towards it, go up or down with it, and keep its distance."""
    WATCH = "watch"
    """Only turn towards it."""


@dataclass(frozen=True, slots=True)
class ServoSettings:
    """What is wanted of the pursuit, and the gains.

    The loops' outputs are, per radian of error: yaw rate for azimuth, vertical velocity over range
    for elevation; and per unit of log scale: forward velocity over `distance_m` for range.

    Attributes:
        mode: whether to chase or only to watch.
        distance_m: wanted distance to the target.
        target_size_m: the square root of the target's width times its height as seen. None holds
            the size that the target has in the image at the start; `distance_m` then says about
            how far that is, and scales the gains.
        elevation_deg: at which elevation to keep the target; None: at the image's centre.
        hold_height: never go up or down.
        centred_deg: up to this azimuth error the forward speed is as the range loop wants it.
        off_axis_deg: from this azimuth error on there is none.
        max_forward_m_s: largest forward velocity.
        max_backward_m_s: largest backward velocity.
        max_vertical_m_s: largest velocity up or down.
        max_yaw_rate_deg_s: largest yaw rate.
        target_speed_filter_s: time constant of the target's estimated speed, which is fed forward.
        own_speed_lag_s: how late the estimate's rates are, against our own velocity.
        azimuth: loop from azimuth error to yaw rate.
        elevation: loop from elevation error to vertical velocity over range.
        range: loop from the logarithm of range over wanted range to forward velocity.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    mode: Mode = Mode.CHASE
    distance_m: float = 15.0
    target_size_m: float | None = None
    elevation_deg: float | None = None
    hold_height: bool = False
    centred_deg: float = 10.0
    off_axis_deg: float = 35.0
    max_forward_m_s: float = 10.0
    max_backward_m_s: float = 3.0
    max_vertical_m_s: float = 2.0
    max_yaw_rate_deg_s: float = 60.0
    target_speed_filter_s: float = 0.4
    own_speed_lag_s: float = 0.5
    azimuth: PidSettings = field(default_factory=lambda: PidSettings(kp=1.5))
    elevation: PidSettings = field(default_factory=lambda: PidSettings(kp=0.8, ki=0.1))
    range: PidSettings = field(
        default_factory=lambda: PidSettings(kp=0.5, ki=0.05, kd=0.3, cut_tolerance=0.03)
    )

    def __post_init__(self) -> None:
        positive = (
            self.distance_m,
            self.max_forward_m_s,
            self.max_backward_m_s,
            self.max_vertical_m_s,
            self.max_yaw_rate_deg_s,
            1.0 if self.target_size_m is None else self.target_size_m,
        )
        if not all(0 < value < math.inf for value in positive):
            raise ValueError(f"distances, sizes and speeds are positive, not {self}")
        if not 0 <= self.centred_deg < self.off_axis_deg <= 180:
            raise ValueError("0 <= centred_deg < off_axis_deg <= 180 does not hold")
        if self.elevation_deg is not None and not -90 <= self.elevation_deg <= 90:
            raise ValueError(f"elevation_deg lies within ±90, not {self.elevation_deg}")


class VisualServo:
    """Turns to the target, rises and sinks with it and holds its size in the image.

    Args:
        settings: what is wanted, and the gains.
        mount_pitch_rad: the camera's pitch against the body, at which elevation the target is kept
            if the settings say nothing else.
    """

    def __init__(self, settings: ServoSettings, mount_pitch_rad: float = 0.0) -> None:
        self._settings = s = settings
        wanted = s.elevation_deg
        elevation = mount_pitch_rad if wanted is None else math.radians(wanted)
        self._reference = Reference(s.distance_m, elevation)
        self._centred, self._off_axis = math.radians(s.centred_deg), math.radians(s.off_axis_deg)
        turn = math.radians(s.max_yaw_rate_deg_s)
        self._azimuth_pid = Pid(s.azimuth, -turn, turn)
        self._elevation_pid = Pid(s.elevation)
        self._range_pid = Pid(
            s.range, -s.max_backward_m_s / s.distance_m, s.max_forward_m_s / s.distance_m
        )
        self._target_speed = TargetSpeed(s.target_speed_filter_s, s.own_speed_lag_s)
        self.start()

    def start(self, present: VelocitySetpoint = HOLD) -> None:
        """Begin a pursuit; the first setpoint continues from `present`, the last one flown.

        Without a `target_size_m`, the next estimate's size is the one that will be held.
        """
        s = self._settings
        self._wanted_log_scale: float | None = None
        if s.target_size_m is not None:
            self._wanted_log_scale = math.log(s.target_size_m / s.distance_m)
        self._errors: ServoErrors | None = None
        self._reference.start()
        self.resume(present)

    def resume(self, present: VelocitySetpoint = HOLD) -> None:
        """Go on after a pause with what was wanted before; continues from `present`."""
        self._asked = present if present.is_finite else HOLD
        self._forward, self._climb = self._asked.forward_m_s, -self._asked.down_m_s
        self._last_s: float | None = None
        self._target_speed.reset()

    def nudge(self, nudge: Nudge) -> None:
        """Shift what is wanted, smoothly, until another nudge comes."""
        self._reference.nudge(nudge)

    @property
    def errors(self) -> ServoErrors | None:
        """What the last update saw, None before the first."""
        return self._errors

    def update(
        self, estimate: TargetEstimate, vehicle: VehicleState, allowed: VelocitySetpoint
    ) -> VelocitySetpoint:
        """Return the setpoint for the estimate's time.

        An estimate in the world's frame needs a fresh attitude: without one, the answer is to
        hold. After a pause of more than `PAUSE_S`, and when time ran backwards, the loops resume
        from `allowed`.

        Args:
            estimate: the target, predicted to now.
            vehicle: newest telemetry; without a position the target's speed is not fed
                forward.
            allowed: what the envelope let through of the last setpoint.
        """
        yaw = _yaw(estimate, vehicle)
        if yaw is None:
            self.resume()
            return HOLD
        if self._last_s is not None and not 0 <= estimate.time_s - self._last_s <= PAUSE_S:
            self.resume(allowed)
        interval_s = 0.0 if self._last_s is None else estimate.time_s - self._last_s
        if self._last_s is None:
            self._begin(estimate)
        self._reference.step(interval_s)
        self._errors = self._see(estimate, yaw, vehicle, interval_s)
        if interval_s > 0:
            self._asked = self._steer(self._errors, estimate, allowed, interval_s)
        return self._asked

    def _begin(self, estimate: TargetEstimate) -> None:
        self._last_s = estimate.time_s
        if self._wanted_log_scale is None:
            self._wanted_log_scale = estimate.log_scale
        range_m = self._range(estimate)
        self._azimuth_pid.start(self._asked.yaw_rate_rad_s)
        self._elevation_pid.start(-self._asked.down_m_s / range_m)
        self._range_pid.start(self._asked.forward_m_s / self._settings.distance_m)

    def _see(
        self, estimate: TargetEstimate, yaw: float, vehicle: VehicleState, interval_s: float
    ) -> ServoErrors:
        range_m = self._range(estimate)
        return ServoErrors(
            azimuth_rad=wrap_angle(estimate.azimuth_rad - yaw),
            elevation_rad=estimate.elevation_rad - self._reference.elevation_rad,
            log_range=math.log(range_m / self._reference.distance_m),
            range_m=range_m,
            target_speed_m_s=self._seen_speed(estimate, vehicle, range_m, interval_s),
        )

    def _seen_speed(
        self, estimate: TargetEstimate, vehicle: VehicleState, range_m: float, interval_s: float
    ) -> float:
        own_speed = _speed_towards(estimate, vehicle)
        if own_speed is None:
            self._target_speed.reset()
            return 0.0
        range_rate = -range_m * estimate.log_scale_rate_s
        return self._target_speed.update(own_speed, range_rate, interval_s)

    def _range(self, estimate: TargetEstimate) -> float:
        """Return the distance to the target, within a factor of ten of the wanted one."""
        wanted = estimate.log_scale if self._wanted_log_scale is None else self._wanted_log_scale
        return self._settings.distance_m * math.exp(_clip(wanted - estimate.log_scale, LOG_TEN))

    def _steer(
        self,
        errors: ServoErrors,
        estimate: TargetEstimate,
        allowed: VelocitySetpoint,
        interval_s: float,
    ) -> VelocitySetpoint:
        self._last_s = estimate.time_s
        yaw_rate = self._turn(errors, estimate, allowed, interval_s)
        if self._settings.mode is Mode.WATCH:
            return VelocitySetpoint(yaw_rate_rad_s=yaw_rate)
        self._forward = self._close_in(errors, estimate, allowed, interval_s)
        centred = self._centred_share(errors.azimuth_rad - self._reference.azimuth_rad)
        return VelocitySetpoint(
            forward_m_s=self._forward * centred,
            right_m_s=self._reference.side_m_s * centred,
            down_m_s=self._sink(errors, estimate, allowed, interval_s),
            yaw_rate_rad_s=yaw_rate,
        )

    def _turn(
        self,
        errors: ServoErrors,
        estimate: TargetEstimate,
        allowed: VelocitySetpoint,
        interval_s: float,
    ) -> float:
        """Yaw rate; the target's own angular rate is known only in the world's frame."""
        in_world = estimate.frame is SightFrame.WORLD
        error = errors.azimuth_rad - self._reference.azimuth_rad
        return self._azimuth_pid.update(
            error,
            -errors.azimuth_rad,
            interval_s,
            feed_forward=estimate.azimuth_rate_rad_s if in_world else 0.0,
            cut=self._asked.yaw_rate_rad_s - allowed.yaw_rate_rad_s,
        )

    def _sink(
        self,
        errors: ServoErrors,
        estimate: TargetEstimate,
        allowed: VelocitySetpoint,
        interval_s: float,
    ) -> float:
        """Downward velocity: the loop's output is the climb over the range.

        Closing in on a target that lies below, it would sink in the image by itself. Fed forward
        is the climb that keeps its elevation: the closing speed, which over the range is the rate
        of the log scale, times the elevation's tangent.
        """
        if self._settings.hold_height:
            return 0.0
        slope = math.tan(_clip(estimate.elevation_rad, _STEEPEST_RAD))
        climb = errors.range_m * self._elevation_pid.update(
            errors.elevation_rad,
            -errors.elevation_rad,
            interval_s,
            feed_forward=slope * estimate.log_scale_rate_s,
            cut=(self._climb + allowed.down_m_s) / errors.range_m,
        )
        self._climb = climb
        return -_clip(climb, self._settings.max_vertical_m_s)

    def _close_in(
        self,
        errors: ServoErrors,
        estimate: TargetEstimate,
        allowed: VelocitySetpoint,
        interval_s: float,
    ) -> float:
        """Forward velocity before it is slowed for a target off-axis."""
        distance = self._settings.distance_m
        return distance * self._range_pid.update(
            errors.log_range,
            estimate.log_scale,
            interval_s,
            feed_forward=errors.target_speed_m_s / distance,
            cut=(self._forward - allowed.forward_m_s) / distance,
        )

    def _centred_share(self, azimuth_rad: float) -> float:
        """Return 1 for a target ahead, falling smoothly to 0 for one off-axis."""
        width = self._off_axis - self._centred
        x = min(max((self._off_axis - abs(azimuth_rad)) / width, 0.0), 1.0)
        return x * x * (3 - 2 * x)


def _yaw(estimate: TargetEstimate, vehicle: VehicleState) -> float | None:
    """Return the heading at the estimate's time, in the estimate's frame; None if unknown."""
    if estimate.frame is SightFrame.BODY:
        return 0.0
    age_s = vehicle.attitude_age_s(estimate.time_s)
    if vehicle.attitude is None or age_s > PAUSE_S:
        return None
    return turned_on(vehicle.attitude, _clip(age_s, 0.1)).yaw_rad


def _speed_towards(estimate: TargetEstimate, vehicle: VehicleState) -> float | None:
    """Return our own speed towards the target, None if it is not known."""
    position = vehicle.position
    fresh = vehicle.position_age_s(estimate.time_s) <= PAUSE_S
    if position is None or not fresh or estimate.frame is SightFrame.BODY:
        return None
    north, east = math.cos(estimate.azimuth_rad), math.sin(estimate.azimuth_rad)
    return position.north_m_s * north + position.east_m_s * east


def _clip(value: float, largest: float) -> float:
    return min(max(value, -largest), largest)
