"""How the vehicle moves now, by telemetry of which a single value may be wrong."""

from __future__ import annotations

import math
from collections import deque
from statistics import median

from follower_control.setpoint import HOLD, VelocitySetpoint
from follower_control.vehicle import VehicleState

_KEPT = 5
_LEAST = 3
_FAR_M_S = 2.0
_FAR_RAD_S = 1.0


class PresentMotion:
    """The newest velocity and yaw rate that are told, unless the last few say something else.

    A setpoint stream begins where the vehicle is. A single glitch of its velocity at that moment
    would be flown for seconds, for it fades away within acceleration and jerk.
    """

    def __init__(self) -> None:
        self._vehicle = VehicleState()
        self._velocities: deque[tuple[float, float, float]] = deque(maxlen=_KEPT)
        self._yaw_rates: deque[float] = deque(maxlen=_KEPT)

    def hear(self, vehicle: VehicleState) -> None:
        """Take the newest telemetry, the same again if there is none newer."""
        before, self._vehicle = self._vehicle, vehicle
        position, attitude = vehicle.position, vehicle.attitude
        if position is not None and position is not before.position:
            self._velocities.append((position.north_m_s, position.east_m_s, position.down_m_s))
        if attitude is not None and attitude is not before.attitude:
            self._yaw_rates.append(attitude.yaw_rate_rad_s)

    @property
    def present(self) -> VelocitySetpoint:
        """The motion as a setpoint in the heading's frame; standing still where it is unknown."""
        attitude = self._vehicle.attitude
        if not self._velocities or attitude is None:
            return HOLD
        parts = zip(*self._velocities, strict=True)
        velocity = tuple(_believed(part, _FAR_M_S) for part in parts)
        return _in_heading(
            velocity, attitude.yaw_rad, _believed(tuple(self._yaw_rates), _FAR_RAD_S)
        )


def heading_velocity(vehicle: VehicleState) -> VelocitySetpoint:
    """Return the motion that is told as a setpoint; standing still where it is unknown."""
    position, attitude = vehicle.position, vehicle.attitude
    if position is None or attitude is None:
        return HOLD
    velocity = position.north_m_s, position.east_m_s, position.down_m_s
    return _in_heading(velocity, attitude.yaw_rad, attitude.yaw_rate_rad_s)


def _in_heading(
    velocity: tuple[float, ...], yaw_rad: float, yaw_rate_rad_s: float
) -> VelocitySetpoint:
    north, east, down = velocity
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return VelocitySetpoint(c * north + s * east, c * east - s * north, down, yaw_rate_rad_s)


def _believed(told: tuple[float, ...], far: float) -> float:
    """Return the last one, or the middle one if the last is far from that."""
    newest, middle = told[-1], median(told)
    return newest if len(told) < _LEAST or abs(newest - middle) <= far else middle
