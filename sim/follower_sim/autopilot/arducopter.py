"""ArduCopter's own rules."""

import math
from dataclasses import replace

from follower_sim.autopilot.firmware import ARDUCOPTER, FlightMode
from follower_sim.autopilot.flight_controller import (
    BODY_NED,
    BODY_OFFSET_NED,
    LOCAL_NED,
    LOCAL_OFFSET_NED,
    POSITION_BITS,
    STOP,
    VELOCITY_BITS,
    YAW_BIT,
    YAW_RATE_BIT,
    FlightController,
    PositionTarget,
    Setpoint,
    is_finite,
    turned,
)
from follower_sim.kinematics import Triple
from follower_sim.vehicle.response import Demand
from follower_sim.vehicle.vehicle import SimulatedVehicle
from follower_vision.geometry.line_of_sight import wrap_angle

_BODY = (BODY_NED, BODY_OFFSET_NED)


def arducopter_setpoint(
    target: PositionTarget, heading_rad: float, position_m: Triple
) -> Setpoint | None:
    """Return what ArduCopter makes of a message that arrives at this heading and position.

    It flies frames 1, 7, 8 and 9; a message in another frame is left out: None. A position,
    velocity or acceleration of which any component is ignored is ignored wholly; if nothing is
    left, or a number is not finite, it stops. Where velocity and position are given both, the
    velocity carries the position along.
    """
    if target.frame not in (LOCAL_NED, LOCAL_OFFSET_NED, *_BODY):
        return None
    yaw = _yaw(target, heading_rad)
    if target.uses_all(VELOCITY_BITS):
        velocity = _in_world(target.velocity_m_s, target.frame, heading_rad)
        return Setpoint(velocity, None, *yaw) if is_finite(velocity) else STOP
    if target.uses_all(POSITION_BITS) and is_finite(target.position_m):
        goal = _goal(target, heading_rad, position_m)
        return Setpoint((0.0, 0.0, 0.0), goal, *yaw)
    return STOP


def _in_world(vector: Triple, frame: int, heading_rad: float) -> Triple:
    return turned(vector, heading_rad) if frame in _BODY else vector


def _goal(target: PositionTarget, heading_rad: float, position_m: Triple) -> Triple:
    if target.frame == LOCAL_NED:
        return target.position_m
    offset = _in_world(target.position_m, target.frame, heading_rad)
    north, east, down = (p + o for p, o in zip(position_m, offset, strict=True))
    return north, east, down


def _yaw(target: PositionTarget, heading_rad: float) -> tuple[float | None, float | None, bool]:
    """Return (yaw rate, yaw, faces the velocity); what is not finite keeps the heading."""
    if target.uses_all(YAW_BIT):
        if not math.isfinite(target.yaw_rad):
            return 0.0, None, False
        # In a body frame the angle counts from the present heading, message by message.
        base = heading_rad if target.frame in _BODY else 0.0
        return None, wrap_angle(base + target.yaw_rad), False
    if target.uses_all(YAW_RATE_BIT):
        rate = target.yaw_rate_rad_s
        return rate if math.isfinite(rate) else 0.0, None, False
    return None, None, True


class ArduCopterController(FlightController):
    """GUIDED needs no stream; without one it stops after GUID_TIMEOUT and stays where it is."""

    def __init__(self, vehicle: SimulatedVehicle) -> None:
        super().__init__(ARDUCOPTER, vehicle)

    def take_setpoint(self, target: PositionTarget) -> None:
        """Take in a SET_POSITION_TARGET_LOCAL_NED; it counts in GUIDED alone.

        In the air it ends a take-off that is under way, as the real one does.
        """
        if self.mode.name != "GUIDED":
            return
        result = arducopter_setpoint(target, self.vehicle.state.yaw_rad, self._local_m())
        if result is None:
            return
        self._setpoint = result
        self._setpoint_s = self.now_s
        if not self.landed:
            self._takeoff_down_m = None

    def take_off(self, altitude_m: float) -> bool:
        """Take off in GUIDED, armed and on the ground, to a height above home, metres."""
        ready = self.mode.name == "GUIDED" and self.armed and self.landed
        if not ready or not math.isfinite(altitude_m) or altitude_m <= 0:
            return False
        self._takeoff_down_m = -altitude_m
        north, east, _ = self._local_m()
        self._setpoint = replace(STOP, position_m=(north, east, -altitude_m))
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
        """Stay in GUIDED: the setpoint is the place above by now."""

    def _local_m(self) -> Triple:
        north, east, down = self.vehicle.state.position_m
        return north - self.origin_m[0], east - self.origin_m[1], down - self.origin_m[2]
