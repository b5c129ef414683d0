"""From a velocity demand to the acceleration that an autopilot asks for."""

from __future__ import annotations

import math

from follower_sim.response import VelocityLoop

_ANTI_WINDUP = 2.0


class VelocityControl:
    """The PID loop on one or two world axes, behind its shaping.

    The horizontal axes are one vector, so that a limit bends no direction.
    """

    def __init__(self, loop: VelocityLoop, axes: int, max_acceleration_m_s2: float) -> None:
        self._loop = loop
        self._max = max_acceleration_m_s2
        self._axes = range(axes)
        self.reset([0.0] * axes)

    def reset(self, velocity_m_s: list[float]) -> None:
        """Start from a velocity, without acceleration, integral or distance."""
        self._wanted = list(velocity_m_s)
        self._wanted_acceleration = [0.0 for _ in self._axes]
        self._behind = [0.0 for _ in self._axes]
        self._integral = [0.0 for _ in self._axes]
        self._beyond = [0.0 for _ in self._axes]
        self._is_limited = False

    def update(
        self,
        demand_m_s: list[float],
        velocity_m_s: list[float],
        acceleration_m_s2: list[float],
        dt: float,
    ) -> list[float]:
        """Return the acceleration to ask for, axis by axis, m/s2."""
        self._shape(demand_m_s, velocity_m_s, dt)
        loop, errors, asked = self._loop, [], []
        leads_on = not self._drives_beyond(self._wanted, self._behind)
        for i in self._axes:
            self._behind[i] += (leads_on * self._wanted[i] - velocity_m_s[i]) * dt
            error = self._wanted[i] + loop.position_per_s * self._behind[i] - velocity_m_s[i]
            lead = self._wanted_acceleration[i]
            slope = loop.d * (lead - acceleration_m_s2[i])
            errors.append(error)
            asked.append(lead + loop.p_per_s * error + self._integral[i] + slope)
        return self._limit(asked, errors, dt)

    def _drives_beyond(self, change: list[float], error: list[float]) -> bool:
        """Whether a target moves on, away from the vehicle, towards what the tilt cannot give.

        ArduCopter does not let it (`update_pos_vel_accel_xy` in AP_Math's control.cpp).
        """
        if not self._is_limited:
            return False
        return _dot(change, self._beyond) > 0 and _dot(error, self._beyond) > 0

    def _shape(self, demand: list[float], velocity: list[float], dt: float) -> None:
        shaping = self._loop.shaping
        if shaping is None:
            self._wanted = demand
            return
        goal = [shaping.rate_per_s * (d - w) for d, w in zip(demand, self._wanted, strict=True)]
        goal = shortened(goal, shaping.acceleration_m_s2)
        change = [g - a for g, a in zip(goal, self._wanted_acceleration, strict=True)]
        change = shortened(change, shaping.jerk_m_s3 * dt)
        for i in self._axes:
            self._wanted_acceleration[i] += change[i]
        error = [w - v for w, v in zip(self._wanted, velocity, strict=True)]
        if self._drives_beyond(self._wanted_acceleration, error) and (
            _dot(self._wanted, self._beyond) >= 0
        ):
            return
        for i in self._axes:
            self._wanted[i] += self._wanted_acceleration[i] * dt

    def _limit(self, asked: list[float], errors: list[float], dt: float) -> list[float]:
        """Limit the acceleration; what was cut off is taken back from the integral."""
        allowed = shortened(asked, self._max)
        self._is_limited, self._beyond = allowed is not asked, asked
        back = _ANTI_WINDUP / self._loop.p_per_s
        for i in self._axes:
            error = errors[i] - back * (asked[i] - allowed[i])
            self._integral[i] += self._loop.i_per_s2 * error * dt
        return allowed


def _dot(one: list[float], other: list[float]) -> float:
    return sum(a * b for a, b in zip(one, other, strict=True))


def shortened(vector: list[float], longest: float) -> list[float]:
    """Return the vector, its direction kept, no longer than `longest`."""
    length = math.hypot(*vector)
    if length <= longest:
        return vector
    return [x * longest / length for x in vector]
