"""The flying body: tilt, thrust, drag, gravity and the ground."""

from __future__ import annotations

import math

from follower_sim.angles import wrap
from follower_sim.kinematics import BodyState, Triple
from follower_sim.response import VehicleResponse

_GRAVITY_M_S2 = 9.80665
_MAX_SINK_ACCELERATION_M_S2 = 8.0


class Airframe:
    """Turns asked-for accelerations into motion; north, east, down, plain floats.

    Attributes:
        position, velocity: metres and m/s.
        acceleration: the last step's, m/s2.
        heading_rate_rad_s: how fast the heading turns.
        wind_m_s: the air's velocity.
    """

    def __init__(self, response: VehicleResponse, start: BodyState) -> None:
        self._tilt = response.tilt
        self._drag = response.drag
        self._thrust_lag_s = response.thrust_lag_s
        self._max_climb = response.max_climb_acceleration_m_s2
        self.position = list(start.position_m)
        self.velocity = list(start.velocity_m_s)
        self.acceleration = [0.0, 0.0, 0.0]
        self.wind_m_s: Triple = (0.0, 0.0, 0.0)
        self._roll, self._pitch, self._yaw = start.attitude_rad
        self._roll_rate = self._pitch_rate = self.heading_rate_rad_s = 0.0
        self._thrust = 0.0  # vertical acceleration by the motors beyond hovering, down

    @property
    def on_ground(self) -> bool:
        """Whether it touches the plane down = 0."""
        return self.position[2] >= 0.0

    def state(self, time_s: float) -> BodyState:
        """Return the truth as others see it."""
        north, east, down = self.position
        v_north, v_east, v_down = self.velocity
        return BodyState(
            time_s,
            (north, east, down),
            (v_north, v_east, v_down),
            (self._roll, self._pitch, self._yaw),
            self._body_rates(),
        )

    def fly(self, level_m_s2: list[float], down_m_s2: float, yaw_rate: float, dt: float) -> None:
        """Advance under the accelerations that the velocity loops ask for.

        Args:
            level_m_s2: (north, east).
            down_m_s2: downwards, beyond hovering.
            yaw_rate: about the body's down axis, rad/s.
            dt: seconds.
        """
        self._turn(level_m_s2, yaw_rate, dt)
        forward = -_GRAVITY_M_S2 * math.tan(self._pitch)
        right = _GRAVITY_M_S2 * math.tan(self._roll) / math.cos(self._pitch)
        cos_yaw, sin_yaw = math.cos(self._yaw), math.sin(self._yaw)
        wanted = max(-self._max_climb, min(_MAX_SINK_ACCELERATION_M_S2, down_m_s2))
        self._thrust += (wanted - self._thrust) * min(1.0, dt / self._thrust_lag_s)
        self._move(
            forward * cos_yaw - right * sin_yaw,
            forward * sin_yaw + right * cos_yaw,
            self._thrust,
            dt,
        )

    def fall(self, dt: float) -> None:
        """Advance with the motors off."""
        self._thrust = 0.0
        self._move(0.0, 0.0, 0.0 if self.on_ground else _GRAVITY_M_S2, dt)

    def _turn(self, level: list[float], yaw_rate: float, dt: float) -> None:
        cos_yaw, sin_yaw = math.cos(self._yaw), math.sin(self._yaw)
        forward = level[0] * cos_yaw + level[1] * sin_yaw
        right = level[1] * cos_yaw - level[0] * sin_yaw
        pitch = -math.atan2(forward, _GRAVITY_M_S2)
        roll = math.atan2(right * math.cos(pitch), _GRAVITY_M_S2)
        self._roll_rate += self._pull(roll - self._roll, self._roll_rate) * dt
        self._pitch_rate += self._pull(pitch - self._pitch, self._pitch_rate) * dt
        self._roll += self._roll_rate * dt
        self._pitch += self._pitch_rate * dt
        # The body's rate is what is controlled: pitching while rolled turns the nose.
        sideways = self._pitch_rate * math.sin(self._roll)
        self.heading_rate_rad_s = (yaw_rate + sideways) / (
            math.cos(self._roll) * math.cos(self._pitch)
        )
        self._yaw = wrap(self._yaw + self.heading_rate_rad_s * dt)

    def _pull(self, error: float, rate: float) -> float:
        frequency = self._tilt.natural_frequency_rad_s
        return frequency * (frequency * error - 2 * self._tilt.damping * rate)

    def _move(self, north: float, east: float, down: float, dt: float) -> None:
        (v_north, v_east, v_down), wind = self.velocity, self.wind_m_s
        air_north, air_east, air_down = v_north - wind[0], v_east - wind[1], v_down - wind[2]
        drag = self._drag.linear_per_s + self._drag.quadratic_per_m * math.hypot(
            air_north, air_east
        )
        north -= drag * air_north
        east -= drag * air_east
        down -= self._drag.vertical_per_s * air_down
        self.acceleration = [north, east, down]
        v_north, v_east, v_down = v_north + north * dt, v_east + east * dt, v_down + down * dt
        self.velocity = [v_north, v_east, v_down]
        at_north, at_east, at_down = self.position
        self.position = [at_north + v_north * dt, at_east + v_east * dt, at_down + v_down * dt]
        if self.position[2] >= 0.0:
            self._touch_down()

    def _touch_down(self) -> None:
        self.position[2] = 0.0
        self.velocity = [0.0, 0.0, 0.0]
        self.acceleration = [0.0, 0.0, 0.0]
        self._roll = self._pitch = 0.0
        self._roll_rate = self._pitch_rate = self.heading_rate_rad_s = 0.0
        self._thrust = min(self._thrust, 0.0)

    def _body_rates(self) -> Triple:
        sin_roll, cos_roll = math.sin(self._roll), math.cos(self._roll)
        sin_pitch, cos_pitch = math.sin(self._pitch), math.cos(self._pitch)
        return (
            self._roll_rate - self.heading_rate_rad_s * sin_pitch,
            self._pitch_rate * cos_roll + self.heading_rate_rad_s * sin_roll * cos_pitch,
            self.heading_rate_rad_s * cos_roll * cos_pitch - self._pitch_rate * sin_roll,
        )
