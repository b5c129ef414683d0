"""The rules of an autopilot: modes, arming, take-off, return, landing. No MAVLink, no bytes."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

from follower_sim.autopilot.firmware import Behaviour, Firmware, FlightMode
from follower_sim.kinematics import Triple
from follower_sim.vehicle.response import STAND_STILL, Demand
from follower_sim.vehicle.vehicle import SimulatedVehicle
from follower_vision.geometry.line_of_sight import wrap_angle

POSITION_BITS = 0x007
VELOCITY_BITS = 0x038
YAW_BIT = 0x400
YAW_RATE_BIT = 0x800

LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED = 1, 7, 8, 9

CRITICAL, WARNING, INFO = 2, 4, 6
"""MAV_SEVERITY."""
_POSITION_GAIN_PER_S = 0.95
_HEADING_GAIN_PER_S = 2.0
_FASTEST_HEADING_RAD_S = math.radians(60.0)
_DISARM_IDLE_S = 10.0
"""From arming until it gives up waiting for a take-off."""
_NEAR_M = 1.0
_STANDING_M_S = 0.3
_REACHED_M = 0.1
_TAKEOFF_BRAKING_M_S2 = 0.5


@dataclass(frozen=True, slots=True)
class PositionTarget:
    """The message's fields, as they came: bits set in `type_mask` are to be ignored."""

    frame: int
    type_mask: int
    position_m: Triple
    velocity_m_s: Triple
    yaw_rad: float
    yaw_rate_rad_s: float

    def uses_any(self, bits: int) -> bool:
        """Whether not all of these fields are ignored."""
        return self.type_mask & bits != bits

    def uses_all(self, bits: int) -> bool:
        """Whether none of these fields is ignored."""
        return self.type_mask & bits == 0


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What the autopilot flies from now on; world axes, north-east-down.

    Attributes:
        velocity_m_s: the velocity, or how fast the position itself moves.
        position_m: in the local frame; None flies the velocity alone.
        yaw_rate_rad_s: positive is clockwise seen from above; None leaves that to the others.
        yaw_rad: the heading to turn to, from north.
        faces_velocity: the nose turns into the velocity.
    """

    velocity_m_s: Triple
    position_m: Triple | None = None
    yaw_rate_rad_s: float | None = None
    yaw_rad: float | None = None
    faces_velocity: bool = False


STOP = Setpoint((0.0, 0.0, 0.0), yaw_rate_rad_s=0.0)


def turned(vector: Triple, yaw_rad: float) -> Triple:
    """Return a heading-frame vector (forward, right, down) in the world."""
    cos_yaw, sin_yaw = math.cos(yaw_rad), math.sin(yaw_rad)
    forward, right, down = vector
    return forward * cos_yaw - right * sin_yaw, forward * sin_yaw + right * cos_yaw, down


def is_finite(vector: Triple) -> bool:
    """Whether all three numbers are finite."""
    return all(map(math.isfinite, vector))


class FlightController(ABC):
    """What both autopilots have in common; one subclass for each.

    Attributes:
        firmware: its constants.
        vehicle: what it flies.
        mode: the present flight mode.
        armed: motors turn.
        in_failsafe: it is in a mode that nobody chose.
        texts: what it has to say, (severity, text), until somebody takes it.
        parameters: by name.
        refuses_setpoints: the mode that flies setpoints is not entered.
        refused_modes: names of others that are not.
        arms_from_s: it is not fit to fly, and does not arm, before.
        home_m: where it returns to, metres NED in the world.
        pulses_us: what the pilot's receiver gives, channel by channel; empty without one.
    """

    def __init__(self, firmware: Firmware, vehicle: SimulatedVehicle) -> None:
        self.firmware = firmware
        self.vehicle = vehicle
        self.armed = vehicle.motors_on
        self.texts: list[tuple[int, str]] = []
        self.parameters = dict(firmware.parameters)
        start = firmware.hold_mode if self.armed else firmware.start_mode
        self.mode = firmware.modes[start]
        north, east, _ = vehicle.state.position_m
        self.origin_m: Triple = (north, east, 0.0)
        self.home_m = self.origin_m
        self._setpoint: Setpoint = STOP
        self._setpoint_s = -math.inf
        self._hold_m: Triple | None = None
        self._hold_yaw_rad = vehicle.state.yaw_rad
        self._takeoff_down_m: float | None = None
        self._armed_s = vehicle.state.time_s
        self._grounded_s = vehicle.state.time_s
        self._flown = self.armed
        self.in_failsafe = False
        self.refuses_setpoints = False
        self.refused_modes: tuple[str, ...] = ()
        self.arms_from_s = -math.inf
        self.pulses_us: tuple[int, ...] = ()

    @property
    def now_s(self) -> float:
        """The simulation's time."""
        return self.vehicle.state.time_s

    @property
    def landed(self) -> bool:
        """Whether it stands on the ground."""
        return self.vehicle.on_ground

    @abstractmethod
    def take_setpoint(self, target: PositionTarget) -> None:
        """Take in a SET_POSITION_TARGET_LOCAL_NED addressed to this vehicle."""

    @abstractmethod
    def take_off(self, altitude_m: float) -> bool:
        """Take off as MAV_CMD_NAV_TAKEOFF asks, altitude in metres; whether that is accepted."""

    def _may_enter(self, mode: FlightMode) -> bool:  # noqa: ARG002
        """Whether a mode may be entered now."""
        return True

    @abstractmethod
    def _fly_setpoint(self) -> Demand:
        """Return what the setpoint mode asks for now."""

    @abstractmethod
    def _on_takeoff_done(self) -> None:
        """Do what follows a take-off."""

    def set_mode(self, mode: FlightMode) -> bool:
        """Change the mode because somebody asks for it; whether that is accepted."""
        refused = self.refuses_setpoints and mode.behaviour is Behaviour.SETPOINTS
        if refused or mode.name in self.refused_modes or not self._may_enter(mode):
            return False
        self._enter(mode)
        return True

    def arm(self, force: bool = False) -> bool:
        """Start the motors; whether that is accepted."""
        if not self.armed:
            if self.now_s < self.arms_from_s and not force:
                self.texts.append((CRITICAL, self.firmware.unfit_text))
                return False
            if not (self.mode.can_arm or force):
                self.texts.append((CRITICAL, f"Arm: {self.mode.name} mode not armable"))
                return False
            self.armed = True
            self._armed_s = self.now_s
            self._flown = False
        return True

    def disarm(self, force: bool = False) -> bool:
        """Stop the motors; refused in the air unless forced."""
        if not self.landed and not force:
            return False
        self.armed = False
        self._takeoff_down_m = None
        return True

    def step(self) -> None:
        """Advance by the vehicle's step."""
        spooled_up = self.now_s - self._armed_s >= self.firmware.spool_up_s or not self.landed
        demand = self._demand() if self.armed and spooled_up else STAND_STILL
        self.vehicle.motors_on = self.armed
        self.vehicle.step(demand)
        self._watch_ground()

    @property
    def _setpoint_age_s(self) -> float:
        return self.now_s - self._setpoint_s

    def _enter(self, mode: FlightMode) -> None:
        self.mode = mode
        self._hold_m = None
        self._hold_yaw_rad = self.vehicle.state.yaw_rad
        self._takeoff_down_m = None

    def _demand(self) -> Demand:
        behaviour = self.mode.behaviour
        if self._takeoff_down_m is not None:
            return self._climb(self._takeoff_down_m)
        if behaviour is Behaviour.SETPOINTS:
            return self._fly_setpoint()
        if behaviour is Behaviour.RETURN:
            return self._return()
        if behaviour is Behaviour.LAND:
            return self._vertical(self.firmware.landing_speed_m_s)
        return self._hold()

    def _hold(self) -> Demand:
        """Brake, then keep the place where it came to a stop."""
        state = self.vehicle.state
        if self.landed:
            return STAND_STILL
        if self._hold_m is None:
            if math.hypot(*state.velocity_m_s) > _STANDING_M_S:
                return self._vertical(0.0)
            self._hold_m = state.position_m
        return Demand(self._towards(self._hold_m, 1.0), self._turn_to(self._hold_yaw_rad))

    def _vertical(self, down_m_s: float) -> Demand:
        """Return a climb or descent on the spot, the heading kept."""
        return Demand((0.0, 0.0, down_m_s), self._turn_to(self._hold_yaw_rad))

    def _climb(self, goal_down_m: float) -> Demand:
        below_m = self.vehicle.state.position_m[2] - goal_down_m
        if below_m < _REACHED_M:
            self._takeoff_down_m = None
            self._on_takeoff_done()
        slowing = math.sqrt(2.0 * _TAKEOFF_BRAKING_M_S2 * max(below_m, 0.0))
        return self._vertical(-min(self.firmware.takeoff_speed_m_s, slowing))

    def _return(self) -> Demand:
        """Climb to the return height, fly home nose first, land."""
        north, east, down = self.vehicle.state.position_m
        home_north, home_east, _ = self.home_m
        distance = math.hypot(home_north - north, home_east - east)
        if distance < _NEAR_M:
            return self._vertical(self.firmware.landing_speed_m_s)
        height = self.firmware.return_height_m
        if -down < height - 1.0:
            return self._vertical(-self.firmware.takeoff_speed_m_s)
        bearing = math.atan2(home_east - east, home_north - north)
        goal = (home_north, home_east, min(down, -height))
        self._hold_yaw_rad = bearing
        return Demand(self._towards(goal, self.firmware.cruise_m_s), self._turn_to(bearing))

    def _towards(self, goal_m: Triple, speed_m_s: float) -> Triple:
        """Return the velocity that closes the distance, no faster than `speed_m_s`."""
        away = [g - p for g, p in zip(goal_m, self.vehicle.state.position_m, strict=True)]
        north, east, down = (_POSITION_GAIN_PER_S * a for a in away)
        return self._clipped((north, east, down), speed_m_s)

    def _clipped(self, velocity_m_s: Triple, speed_m_s: float | None = None) -> Triple:
        limits = self.firmware.limits
        north, east, down = velocity_m_s
        most = limits.horizontal_m_s if speed_m_s is None else speed_m_s
        share = min(1.0, most / max(math.hypot(north, east), 1e-9))
        return north * share, east * share, max(-limits.up_m_s, min(limits.down_m_s, down))

    def _turn_to(self, heading_rad: float) -> float:
        """Return the yaw rate that turns the nose to a heading."""
        rate = _HEADING_GAIN_PER_S * wrap_angle(heading_rad - self.vehicle.state.yaw_rad)
        return max(-_FASTEST_HEADING_RAD_S, min(_FASTEST_HEADING_RAD_S, rate))

    def _setpoint_demand(self, setpoint: Setpoint) -> Demand:
        """Return what a setpoint asks for, within the limits."""
        north, east, down = setpoint.velocity_m_s
        if setpoint.position_m is not None:
            local_m = zip(setpoint.position_m, self.origin_m, strict=True)
            goal_north, goal_east, goal_down = (p + o for p, o in local_m)
            pull = self._towards((goal_north, goal_east, goal_down), self.firmware.cruise_m_s)
            north, east, down = north + pull[0], east + pull[1], down + pull[2]
        velocity = self._clipped((north, east, down))
        return Demand(velocity, self._setpoint_yaw_rate(setpoint, velocity))

    def _setpoint_yaw_rate(self, setpoint: Setpoint, velocity: Triple) -> float:
        most = math.radians(self.firmware.limits.yaw_rate_deg_s)
        if setpoint.yaw_rate_rad_s is not None:
            return max(-most, min(most, setpoint.yaw_rate_rad_s))
        if setpoint.yaw_rad is not None:
            return self._turn_to(setpoint.yaw_rad)
        if setpoint.faces_velocity and math.hypot(velocity[0], velocity[1]) > _STANDING_M_S:
            return self._turn_to(math.atan2(velocity[1], velocity[0]))
        return 0.0

    def _watch_ground(self) -> None:
        """Disarm after a landing, or when nothing follows the arming."""
        if not self.landed:
            self._flown = True
            self._grounded_s = self.now_s
            return
        if not self.armed:
            return
        lands = self.mode.behaviour in (Behaviour.LAND, Behaviour.RETURN)
        if self._flown and lands:
            if self.now_s - self._grounded_s > self.firmware.disarm_landed_s:
                self.disarm()
        elif self.now_s - max(self._grounded_s, self._armed_s) > _DISARM_IDLE_S:
            self.disarm()
