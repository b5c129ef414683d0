"""PX4's own rules."""

from __future__ import annotations

import math

from follower_sim.demand import Demand
from follower_sim.firmware import PX4
from follower_sim.flight_controller import CRITICAL, FlightController
from follower_sim.flight_modes import FlightMode
from follower_sim.position_target import PositionTarget, Refusal
from follower_sim.px4_setpoints import px4_setpoint
from follower_sim.vehicle import Vehicle

_FAILSAFE_REACTION_S = 0.25
"""From the loss time-out until the failsafe acts, as recorded."""


class Px4Controller(FlightController):
    """OFFBOARD needs a running stream, falls back to RTL without one, and comes back with it."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(PX4, vehicle)
        self._in_failsafe = False

    @property
    def in_failsafe(self) -> bool:
        """Whether it does what nobody chose."""
        return self._in_failsafe

    def take_setpoint(self, target: PositionTarget) -> None:
        """Take in a SET_POSITION_TARGET_LOCAL_NED; in any mode it keeps the stream alive."""
        result = px4_setpoint(target, self.vehicle.state.yaw_rad)
        if isinstance(result, Refusal):
            self.texts.append((CRITICAL, result.text))
            return
        self._setpoint = result
        self._setpoint_s = self.now_s

    def take_off(self, altitude_m: float) -> bool:
        """Enter AUTO.TAKEOFF, to an altitude above mean sea level; NaN is MIS_TAKEOFF_ALT."""
        height = altitude_m - self.firmware.home[2]
        if not math.isfinite(altitude_m):
            height = self.parameters["MIS_TAKEOFF_ALT"] - self.vehicle.state.position_m[2]
        self._enter(self.firmware.modes["TAKEOFF"])
        self._takeoff_down_m = -height
        return True

    def step(self) -> None:
        """Advance by the vehicle's step, after a look at the stream."""
        if self.mode.name == "OFFBOARD" and self.armed and not self._stream_runs():
            self._enter(self.firmware.modes["RTL"])
            self._in_failsafe = True
            self.texts.append((CRITICAL, "Failsafe activated"))
        elif self._in_failsafe and self._stream_runs():
            self._enter(self.firmware.modes["OFFBOARD"])
            self._in_failsafe = False
        super().step()

    def set_mode(self, mode: FlightMode) -> bool:
        """Change the mode; a mode that somebody chose ends the failsafe."""
        accepted = super().set_mode(mode)
        self._in_failsafe = self._in_failsafe and not accepted
        return accepted

    def disarm(self, force: bool = False) -> bool:
        """Stop the motors; RTL and LAND end with that."""
        disarmed = super().disarm(force)
        if disarmed:
            self._in_failsafe = False
        return disarmed

    def _stream_runs(self) -> bool:
        return self._setpoint_age_s <= self.parameters["COM_OF_LOSS_T"] + _FAILSAFE_REACTION_S

    def _may_enter(self, mode: FlightMode) -> bool:
        if mode.name == "OFFBOARD" and self._setpoint_age_s > self.parameters["COM_OF_LOSS_T"]:
            text = "Switching to mode 'Offboard' is currently not possible"
            self.texts.append((CRITICAL, text))
            return False
        return True

    def _enter(self, mode: FlightMode) -> None:
        super()._enter(mode)
        if mode.name == "TAKEOFF":
            height = self.parameters["MIS_TAKEOFF_ALT"]
            self._takeoff_down_m = self.vehicle.state.position_m[2] - height

    def _fly_setpoint(self) -> Demand:
        return self._setpoint_demand(self._setpoint)

    def _on_takeoff_done(self) -> None:
        self._enter(self.firmware.modes["LOITER"])
