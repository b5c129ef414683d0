"""A multirotor with the autopilot's inner loops, stepped at a fixed rate."""

from collections import deque
from collections.abc import Callable
from typing import TypeVar

from follower_sim.kinematics import BodyState, StateHistory, Triple
from follower_sim.vehicle.airframe import Airframe, VelocityControl, YawAxis
from follower_sim.vehicle.response import STAND_STILL, Demand, VehicleResponse

STEP_S = 0.005
"""The fixed step of the simulation: 200 Hz."""

_WIND_EVERY = 4
_LIFT_OFF_M_S = 0.05

_T = TypeVar("_T")

WindField = Callable[[float], Triple]
"""Velocity of the air (north, east, down), m/s, at a time of the simulation."""


class SimulatedVehicle:
    """Follows velocity demands as the recorded vehicles do.

    Deterministic: the same start, demands and wind give the same motion, bit for bit.

    Args:
        response: the flavour's parameters.
        start: where it stands or hovers, and when.
        wind: the air's velocity; None is still air.

    Attributes:
        state: the newest truth.
        history: that of the last seconds.
        motors_on: whether they turn.
    """

    def __init__(
        self, response: VehicleResponse, start: BodyState, wind: WindField | None = None
    ) -> None:
        self._response = response
        self._airframe = Airframe(response, start)
        limit = response.tilt.max_acceleration_m_s2
        self._level = VelocityControl(response.horizontal, 2, limit)
        self._vertical = VelocityControl(response.vertical, 1, 9.0)
        self._yaw = YawAxis(response.yaw)
        self._wind = wind
        self._late_velocity = _waiting(response.dead_time_s, (0.0, 0.0, 0.0))
        self._late_yaw_rate = _waiting(response.yaw.dead_time_s, 0.0)
        self._start_s = start.time_s
        self._steps = 0
        self.state = self._airframe.state(start.time_s)
        self.history = StateHistory(self.state)
        self.motors_on = not self.on_ground

    @property
    def on_ground(self) -> bool:
        """Whether the ground carries it."""
        return self._airframe.on_ground

    def state_at(self, time_s: float) -> BodyState:
        """Return the truth at a time of the last two seconds; earlier or later, the nearest."""
        return self.history.at(time_s)

    def step(self, demand: Demand) -> None:
        """Advance by `STEP_S` under a demand, which takes effect after the dead times."""
        demand = demand if self.motors_on else STAND_STILL
        self._late_velocity.append(demand.velocity_m_s)
        self._late_yaw_rate.append(demand.yaw_rate_rad_s)
        self._fly(self._late_velocity.popleft(), self._late_yaw_rate.popleft())
        self._steps += 1
        now_s = self._start_s + self._steps * STEP_S
        if self._wind is not None and self._steps % _WIND_EVERY == 1:
            self._airframe.wind_m_s = self._wind(now_s)
        self.state = self._airframe.state(now_s)
        self.history.add(self.state)

    def _fly(self, velocity: Triple, yaw_rate: float) -> None:
        lifts = velocity[2] < -_LIFT_OFF_M_S
        if not self.motors_on:
            self._rest()
            self._airframe.fall(STEP_S)
        elif self.on_ground and not lifts:
            self._rest()
        else:
            self._control(velocity, yaw_rate)

    def _rest(self) -> None:
        self._level.reset([0.0, 0.0])
        self._vertical.reset([0.0])
        self._yaw.reset()

    def _control(self, velocity: Triple, yaw_rate: float) -> None:
        frame = self._airframe
        north, east, down = velocity
        down = self._response.biased(down)
        level = self._level.update(
            [north, east], frame.velocity[:2], frame.acceleration[:2], STEP_S
        )
        vertical = self._vertical.update([down], frame.velocity[2:], frame.acceleration[2:], STEP_S)
        body_rate = self._yaw.update(yaw_rate, frame.heading_rate_rad_s, frame.to_turn_rad, STEP_S)
        frame.fly(level, vertical[0], body_rate, STEP_S)


def _waiting(dead_time_s: float, nothing: _T) -> deque[_T]:
    """Return the demands that are still on their way at the start."""
    return deque([nothing] * round(dead_time_s / STEP_S))
