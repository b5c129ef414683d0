"""ArduCopter's own rules."""

from __future__ import annotations

import math
from dataclasses import replace

from follower_sim.arducopter_setpoints import arducopter_setpoint
from follower_sim.demand import Demand
from follower_sim.firmware import ARDUCOPTER
from follower_sim.flight_controller import FlightController
from follower_sim.flight_modes import FlightMode
from follower_sim.kinematics import Triple
from follower_sim.position_target import STOP, PositionTarget, Refusal
from follower_sim.vehicle import Vehicle


class ArduCopterController(FlightController):
    """GUIDED needs no stream; without one it stops after GUID_TIMEOUT and stays where it is."""

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(ARDUCOPTER, vehicle)

    def take_setpoint(self, target: PositionTarget) -> None:
        """Take in a SET_POSITION_TARGET_LOCAL_NED; it counts in GUIDED alone.

        In the air it ends a take-off that is under way, as the real one does.
        """
        if self.mode.name != "GUIDED":
            return
        result = arducopter_setpoint(target, self.vehicle.state.yaw_rad, self._local_m())
        if isinstance(result, Refusal):
            return
        self._setpoint = result
        self._setpoint_s = self.now_s
        if not self.landed:
            self._takeoff_down_m = None

    def take_off(self, altitude_m: float) -> bool:
        """Take off in GUIDED, armed and on the ground, to a height above home."""
        ready = self.mode.name == "GUIDED" and self.armed and self.landed
        if not ready or not math.isfinite(altitude_m) or altitude_m <= 0:
            return False
        self._takeoff_down_m = -altitude_m
        north, east, _ = self._local_m()
        self._setpoint = replace(STOP, position_m=(north, east, -altitude_m))
        return True

    def _may_enter(self, mode: FlightMode) -> bool:  # noqa: ARG002
        return True

    def _enter(self, mode: FlightMode) -> None:
        super()._enter(mode)
        self._setpoint = STOP

    def _fly_setpoint(self) -> Demand:
        setpoint = self._setpoint
        if self.landed:
            return Demand()  # GUIDED leaves the ground by a take-off command alone
        moves = setpoint.position_m is None
        if moves and self._setpoint_age_s > self.parameters["GUID_TIMEOUT"]:
            setpoint = STOP
        return self._setpoint_demand(setpoint)

    def _on_takeoff_done(self) -> None:
        """Stay in GUIDED: the set-point is the place above by now."""

    def _local_m(self) -> Triple:
        north, east, down = self.vehicle.state.position_m
        return north - self.origin_m[0], east - self.origin_m[1], down - self.origin_m[2]
