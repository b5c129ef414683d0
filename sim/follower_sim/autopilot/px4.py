"""PX4's own rules."""

import math

from follower_sim.autopilot.firmware import PX4, FlightMode
from follower_sim.autopilot.flight_controller import (
    BODY_NED,
    CRITICAL,
    LOCAL_NED,
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
from follower_sim.vehicle.response import Demand
from follower_sim.vehicle.vehicle import SimulatedVehicle
from follower_vision.geometry.line_of_sight import wrap_angle

_MESSAGE = "SET_POSITION_TARGET_LOCAL_NED"

_FAILSAFE_REACTION_S = 0.25
"""From the loss time-out until the failsafe acts, as recorded."""


def px4_setpoint(target: PositionTarget, heading_rad: float) -> Setpoint | str:
    """Return what PX4 makes of a message that arrives at this heading, or its complaint.

    It flies frames 1 and 8 alone. Velocity needs all three components; a body frame turns them by
    the heading, and nothing else: positions and headings stay those of the world.
    """
    if target.frame not in (LOCAL_NED, BODY_NED):
        return f"{_MESSAGE} coordinate frame {target.frame} unsupported"
    if not _is_whole(target):
        return f"{_MESSAGE} invalid"
    velocity = target.velocity_m_s if target.uses_all(VELOCITY_BITS) else (0.0, 0.0, 0.0)
    if not is_finite(velocity):
        return STOP
    if target.frame == BODY_NED:
        velocity = turned(velocity, heading_rad)
    return Setpoint(velocity, _position(target), *_yaw(target))


def _is_whole(target: PositionTarget) -> bool:
    """Whether position and velocity are each there wholly or not at all, and one of them is."""
    parts = (POSITION_BITS, VELOCITY_BITS)
    whole = [target.uses_all(bits) for bits in parts]
    return any(whole) and whole == [target.uses_any(bits) for bits in parts]


def _position(target: PositionTarget) -> tuple[float, float, float] | None:
    usable = target.uses_all(POSITION_BITS) and is_finite(target.position_m)
    return target.position_m if usable else None


def _yaw(target: PositionTarget) -> tuple[float | None, float | None]:
    """Return (yaw rate, yaw); what is not finite counts as not given."""
    if target.uses_all(YAW_BIT) and math.isfinite(target.yaw_rad):
        return None, wrap_angle(target.yaw_rad)
    if target.uses_all(YAW_RATE_BIT) and math.isfinite(target.yaw_rate_rad_s):
        return target.yaw_rate_rad_s, None
    return 0.0, None


class Px4Controller(FlightController):
    """OFFBOARD needs a running stream, falls back to RTL without one, and comes back with it."""

    def __init__(self, vehicle: SimulatedVehicle) -> None:
        super().__init__(PX4, vehicle)

    def take_setpoint(self, target: PositionTarget) -> None:
        """Take in a SET_POSITION_TARGET_LOCAL_NED; in any mode it keeps the stream alive."""
        result = px4_setpoint(target, self.vehicle.state.yaw_rad)
        if isinstance(result, str):
            self.texts.append((CRITICAL, result))
            return
        self._setpoint = result
        self._setpoint_s = self.now_s

    def take_off(self, altitude_m: float) -> bool:
        """Enter AUTO.TAKEOFF, to an altitude above sea level, metres; NaN is MIS_TAKEOFF_ALT."""
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
            self.in_failsafe = True
            self.texts.append((CRITICAL, "Failsafe activated"))
        elif self.in_failsafe and self._stream_runs():
            self._enter(self.firmware.modes["OFFBOARD"])
            self.in_failsafe = False
        super().step()

    def set_mode(self, mode: FlightMode) -> bool:
        """Change the mode; a mode that somebody chose ends the failsafe."""
        accepted = super().set_mode(mode)
        self.in_failsafe = self.in_failsafe and not accepted
        return accepted

    def disarm(self, force: bool = False) -> bool:
        """Stop the motors; RTL and LAND end with that."""
        disarmed = super().disarm(force)
        if disarmed:
            self.in_failsafe = False
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
