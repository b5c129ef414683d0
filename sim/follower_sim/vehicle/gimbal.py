"""A simulated gimbal: a camera that keeps its direction while the vehicle turns and tilts."""

import math
from dataclasses import dataclass

from follower_control.common.strict_config import check_positive
from follower_sim.kinematics import BodyState, StateHistory
from follower_vision.geometry.line_of_sight import wrap_angle


@dataclass(frozen=True, slots=True)
class GimbalModel:
    """What a gimbal can do.

    Attributes:
        max_rate_deg_s: its fastest turning, in pitch and in yaw.
        lag_s: time constant with which it takes up a rate.
        lowest_deg: end stop of the pitch, from the horizon.
        highest_deg: the other one.
        widest_deg: end stops of the yaw from the vehicle's nose, either way.
    """

    max_rate_deg_s: float = 90.0
    lag_s: float = 0.06
    lowest_deg: float = -90.0
    highest_deg: float = 30.0
    widest_deg: float = 160.0

    def __post_init__(self) -> None:
        check_positive(self, "max_rate_deg_s", "lag_s", "widest_deg")
        if not -90 <= self.lowest_deg < self.highest_deg <= 90:
            raise ValueError("-90 <= lowest_deg < highest_deg <= 90 does not hold")


class Gimbal:
    """Follows rates against the world between its end stops; level by itself.

    Args:
        model: what it can do.
        pitch_rad: where it looks at first.
        yaw_rad: likewise, from north.
        time_s: the time of the start.

    Attributes:
        wanted: pitch and yaw rate that it was given, rad/s.
        model: what it can do.
    """

    def __init__(self, model: GimbalModel, pitch_rad: float, yaw_rad: float, time_s: float) -> None:
        self.model = model
        self._most = math.radians(model.max_rate_deg_s)
        self._pitch, self._yaw = pitch_rad, wrap_angle(yaw_rad)
        self._pitch_rate = self._yaw_rate = 0.0
        self.wanted = (0.0, 0.0)
        self._history = StateHistory(self._state(time_s))

    @property
    def state(self) -> BodyState:
        """Attitude and rates of the camera as if it were a body; its place is not known."""
        return self._history.newest

    def at(self, time_s: float) -> BodyState:
        """Return the state at a time of the last two seconds."""
        return self._history.at(time_s)

    def camera(self, vehicle: BodyState) -> BodyState:
        """Return the camera as a body in the vehicle's place, at the vehicle's time."""
        held = self.at(vehicle.time_s)
        return BodyState(
            vehicle.time_s,
            vehicle.position_m,
            vehicle.velocity_m_s,
            held.attitude_rad,
            held.rates_rad_s,
        )

    def step(self, time_s: float, interval_s: float, vehicle_yaw_rad: float) -> None:
        """Move on for an interval, seconds, that ends at `time_s`; the vehicle's yaw in rad."""
        pitch, yaw = (min(max(rate, -self._most), self._most) for rate in self.wanted)
        share = interval_s / (interval_s + self.model.lag_s)
        self._pitch_rate += share * (pitch - self._pitch_rate)
        self._yaw_rate += share * (yaw - self._yaw_rate)
        self._pitch += self._pitch_rate * interval_s
        lowest, highest = (
            math.radians(self.model.lowest_deg),
            math.radians(self.model.highest_deg),
        )
        if not lowest <= self._pitch <= highest:
            self._pitch, self._pitch_rate = min(max(self._pitch, lowest), highest), 0.0
        self._turn(interval_s, vehicle_yaw_rad)
        self._history.add(self._state(time_s))

    def _turn(self, interval_s: float, vehicle_yaw_rad: float) -> None:
        """Turn against the world; at an end stop the vehicle takes it along."""
        from_nose = wrap_angle(self._yaw + self._yaw_rate * interval_s - vehicle_yaw_rad)
        widest = math.radians(self.model.widest_deg)
        if abs(from_nose) > widest:
            from_nose = math.copysign(widest, from_nose)
            taken_rad = wrap_angle(vehicle_yaw_rad + from_nose - self._yaw)
            self._yaw_rate = taken_rad / interval_s
        self._yaw = wrap_angle(vehicle_yaw_rad + from_nose)

    def _state(self, time_s: float) -> BodyState:
        rates = (
            -self._yaw_rate * math.sin(self._pitch),
            self._pitch_rate,
            self._yaw_rate * math.cos(self._pitch),
        )
        nowhere = (0.0, 0.0, 0.0)
        return BodyState(time_s, nowhere, nowhere, (0.0, self._pitch, self._yaw), rates)
