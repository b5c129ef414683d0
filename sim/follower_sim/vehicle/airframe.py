"""The flying body: tilt, thrust, drag, gravity and the ground."""

import math

from follower_sim.kinematics import BodyState, Triple
from follower_sim.vehicle.response import VehicleResponse, VelocityLoop, YawResponse
from follower_vision.geometry.line_of_sight import wrap_angle

_GRAVITY_M_S2 = 9.80665
_MAX_SINK_ACCELERATION_M_S2 = 8.0

_ANTI_WINDUP = 2.0


class Airframe:
    """Turns asked-for accelerations into motion; north, east, down, plain floats.

    Attributes:
        position, velocity: metres and m/s.
        acceleration: the last step's, m/s2.
        heading_rate_rad_s: how fast the heading turns.
        wind_m_s: the air's velocity.
        to_turn_rad: about the body's down axis, so that the pitching still to come, while rolled,
            leaves the heading as it is.
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
        self.to_turn_rad = 0.0
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
        wanted = max(-self._max_climb, min(_MAX_SINK_ACCELERATION_M_S2, down_m_s2))
        self._thrust += (wanted - self._thrust) * min(1.0, dt / self._thrust_lag_s)
        # Both autopilots work the tilt out for hovering thrust: climbing pulls harder sideways.
        upright = _GRAVITY_M_S2 - self._thrust
        forward = -upright * math.tan(self._pitch)
        right = upright * math.tan(self._roll) / math.cos(self._pitch)
        cos_yaw, sin_yaw = math.cos(self._yaw), math.sin(self._yaw)
        self._move(
            forward * cos_yaw - right * sin_yaw,
            forward * sin_yaw + right * cos_yaw,
            self._thrust,
            dt,
        )

    def fall(self, dt: float) -> None:
        """Advance with the motors off; the ground carries it, whatever wind blows."""
        self._thrust = 0.0
        if not self.on_ground:
            self._move(0.0, 0.0, _GRAVITY_M_S2, dt)

    def _turn(self, level: list[float], yaw_rate: float, dt: float) -> None:
        cos_yaw, sin_yaw = math.cos(self._yaw), math.sin(self._yaw)
        forward = level[0] * cos_yaw + level[1] * sin_yaw
        right = level[1] * cos_yaw - level[0] * sin_yaw
        pitch = -math.atan2(forward, _GRAVITY_M_S2)
        roll = math.atan2(right * math.cos(pitch), _GRAVITY_M_S2)
        self.to_turn_rad = (self._pitch - pitch) * math.sin(self._roll)
        self._roll_rate += self._pull(roll - self._roll, self._roll_rate) * dt
        self._pitch_rate += self._pull(pitch - self._pitch, self._pitch_rate) * dt
        self._roll += self._roll_rate * dt
        self._pitch += self._pitch_rate * dt
        # The body's rate is what is controlled: pitching while rolled turns the nose.
        sideways = self._pitch_rate * math.sin(self._roll)
        self.heading_rate_rad_s = (yaw_rate + sideways) / (
            math.cos(self._roll) * math.cos(self._pitch)
        )
        self._yaw = wrap_angle(self._yaw + self.heading_rate_rad_s * dt)

    def _pull(self, error: float, rate: float) -> float:
        frequency = self._tilt.natural_frequency_rad_s
        return frequency * (frequency * error - 2 * self._tilt.damping * rate)

    def _move(self, north: float, east: float, down: float, dt: float) -> None:
        (v_north, v_east, v_down), wind = self.velocity, self.wind_m_s
        air_north, air_east, air_down = v_north - wind[0], v_east - wind[1], v_down - wind[2]
        # The square law holds along each of the body's axes: leaning shows less of each to the air.
        upright = math.cos(self._roll) * math.cos(self._pitch)
        shown = upright**3 + (1.0 - upright**2) ** 1.5
        quadratic = self._drag.quadratic_per_m * shown
        drag = self._drag.linear_per_s + quadratic * math.hypot(air_north, air_east)
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
        """Start from a velocity, m/s, without acceleration, integral or distance."""
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


class YawAxis:
    """Follows a rate about the body's down axis with the lags of a real one.

    Attributes:
        rate_rad_s: the present body rate.
    """

    def __init__(self, response: YawResponse) -> None:
        self._response = response
        self._max = math.radians(response.max_acceleration_deg_s2)
        self.reset()

    def reset(self) -> None:
        """Stand still."""
        self.rate_rad_s = 0.0
        self._torque = 0.0
        self._integral = 0.0
        self._behind = 0.0

    def update(
        self, demand_rad_s: float, heading_rate_rad_s: float, to_turn_rad: float, dt: float
    ) -> float:
        """Return the new body rate.

        Args:
            demand_rad_s: the rate asked for.
            heading_rate_rad_s: what the heading really does; while tilted that is not the body's.
            to_turn_rad: what keeps the heading while the tilt changes; see `Airframe`.
            dt: seconds.
        """
        y = self._response
        demand_rad_s += y.turn_per_s * to_turn_rad
        self._behind += (demand_rad_s - heading_rate_rad_s) * dt
        error = demand_rad_s + y.heading_per_s * self._behind - self.rate_rad_s
        asked = y.p_per_s * error + self._integral
        limited = max(-self._max, min(self._max, asked))
        if asked == limited:
            self._integral += y.i_per_s2 * error * dt
        self._torque += (limited - self._torque) * min(1.0, dt / y.lag_s)
        self.rate_rad_s += (self._torque - y.drag_per_s * self.rate_rad_s) * dt
        return self.rate_rad_s
