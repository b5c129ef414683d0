"""What stands between an autopilot's program and the follower: it relays, loses and orders."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterator
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from follower.links.vehicle_monitor import set_mode_params
from follower.simulation.faults.wire_tap import FIRMWARE, FlightEvidence, WireTap
from follower.simulation.sitl.gusts import Gusts
from follower.simulation.sitl.programs import SitlProgram
from follower_control.common.transport import UdpTransport
from follower_sim.scenario.scenario import Scenario
from follower_sim.world.world import World
from follower_vision.clock import MonotonicClock

AT_REST = (0.0, 0.0, -1.0, 0.0)
"""Roll, pitch, throttle, yaw: the throttle down, as both want it for arming."""
_FAST_M_S, _STANDS_M_S = 2.0, 0.6
_AGAIN_S, _STICKS_S, _STICK_STEP = 1.0, 0.05, 0.1
_GROUND_STATION = 255
_OFF_THE_GROUND = (
    mavlink.MAV_LANDED_STATE_IN_AIR,
    mavlink.MAV_LANDED_STATE_TAKEOFF,
    mavlink.MAV_LANDED_STATE_LANDING,
)
_AUTOPILOTS = {"px4": mavlink.MAV_AUTOPILOT_PX4, "ardupilot": mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA}


class Relay:
    """Carries packets between an autopilot and the follower, and speaks as a ground station."""

    def __init__(
        self,
        program: SitlProgram,
        scenario: Scenario,
        autopilot: UdpTransport,
        follower_port: int,
    ) -> None:
        self.clock = MonotonicClock()
        self._gusts = Gusts(program, (), World(scenario), autopilot, self.clock)
        self.flavour = program.flavour
        self._autopilot = autopilot
        self._follower = WireTap(UdpTransport.connect("127.0.0.1", follower_port), self.clock)
        self._codec = mavlink.MAVLink(None, _GROUND_STATION, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self.lost_until_s = {"down": -math.inf, "up": -math.inf}
        self.sticks: tuple[float, float, float, float] | None = None
        """Where they go: roll, pitch, throttle, yaw, within ±1; None: the transmitter is off."""
        self._sticks = AT_REST
        self.begun_s: float | None = None
        self.speed_m_s = self.height_m = 0.0
        self.obeys = self.armed = self.lifted = False
        self.slow_since_s: float | None = None
        self._fast_since_s = math.inf
        self._sticks_due_s = 0.0
        firmware = FIRMWARE[program.flavour]
        self._consent = firmware.setpoint_mode
        self._mode = firmware.modes[firmware.setpoint_mode].custom_mode
        self._system = 1

    @property
    def fast_for_s(self) -> float:
        """How long it has flown fast by setpoints, s."""
        return self.clock.now() - self._fast_since_s

    def step(self) -> float:
        """Carry what has come, and return the time, s."""
        now_s = self.clock.now()
        self._gusts.step(self._system)
        data = self._autopilot.receive()
        for message in self._parser.parse_buffer(data) or []:
            self._look(message, now_s)
        if data and now_s > self.lost_until_s["down"]:
            self._follower.send(data)
        data = self._follower.receive()
        if data and now_s > self.lost_until_s["up"]:
            self._autopilot.send(data)
        moves = self.obeys and self.speed_m_s > _FAST_M_S
        self._fast_since_s = min(self._fast_since_s, now_s) if moves else math.inf
        if self.sticks is not None and now_s > self._sticks_due_s:
            self._sticks_due_s = now_s + _STICKS_S
            # By and by: PX4 takes a jump for noise, and three steps the same way for a pilot.
            steps = ((to - at, at) for to, at in zip(self.sticks, self._sticks, strict=True))
            moved = [at + min(max(off, -_STICK_STEP), _STICK_STEP) for off, at in steps]
            self._sticks = moved[0], moved[1], moved[2], moved[3]
            self._send_sticks(*self._sticks)
        return now_s

    def _look(self, message: Any, now_s: float) -> None:
        kind = message.get_type()
        if kind == "LOCAL_POSITION_NED":
            self.speed_m_s = math.hypot(message.vx, message.vy, message.vz)
            self.height_m = -message.z
            slow = self.speed_m_s < _STANDS_M_S
            self.slow_since_s = (self.slow_since_s or now_s) if slow else None
        elif kind == "EXTENDED_SYS_STATE":
            # Not the height: on the ground PX4's estimate of it drifts by 0.7 m in half a minute.
            self.lifted |= message.landed_state in _OFF_THE_GROUND
        elif kind == "HEARTBEAT" and message.get_srcComponent() == 1:
            self._system = message.get_srcSystem()
            self.obeys = message.custom_mode == self._mode
            self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

    def _send_sticks(self, roll: float, pitch: float, throttle: float, yaw: float) -> None:
        """Send them as a ground station's joystick, which both take for the pilot's."""
        if self.flavour == "px4":
            moved = [round(1000 * x) for x in (pitch, roll, (throttle + 1) / 2, yaw)]
            self._send(mavlink.MAVLink_manual_control_message(self._system, *moved, 0))
            return
        pulses = [round(1500 + 500 * x) for x in (roll, -pitch, throttle, yaw)]
        self._send(mavlink.MAVLink_rc_channels_override_message(self._system, 1, *pulses, *[0] * 4))

    def until(self, reached: Callable[[], bool]) -> Iterator[None]:
        """Wait, a step at a time."""
        while not reached():
            yield

    def pause(self, length_s: float) -> Iterator[None]:
        """Wait so many seconds."""
        end_s = self.clock.now() + length_s
        yield from self.until(lambda: self.clock.now() > end_s)

    def arm_in(self, mode: str) -> Iterator[None]:
        """Take a mode and arm, again and again until it is."""
        self.sticks = AT_REST
        while not self.armed:
            self.order(mode)
            self.arm(True)
            yield from self.pause(_AGAIN_S)

    def give_consent(self) -> Iterator[None]:
        """Take the mode that flies setpoints, again and again until it is."""
        while not self.obeys:
            self.order(self._consent)
            yield from self.pause(_AGAIN_S)

    def order(self, mode: str) -> None:
        """Order a mode as a ground station."""
        params = set_mode_params(_AUTOPILOTS[self.flavour], mode)
        self._command(mavlink.MAV_CMD_DO_SET_MODE, *params)

    def arm(self, armed: bool) -> None:
        """Arm or disarm as a ground station."""
        self._command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, float(armed))

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter as a ground station; PX4 takes an integer's bits for a float."""
        kind = mavlink.MAV_PARAM_TYPE_REAL32
        if isinstance(value, int) and self.flavour == "px4":
            kind = mavlink.MAV_PARAM_TYPE_INT32
            (value,) = struct.unpack("<f", struct.pack("<i", value))
        self._send(mavlink.MAVLink_param_set_message(self._system, 1, name.encode(), value, kind))

    def _command(self, command: int, *params: float) -> None:
        padded = (*params, *(0.0,) * (7 - len(params)))
        self._send(mavlink.MAVLink_command_long_message(self._system, 1, command, 0, *padded))

    def _send(self, message: Any) -> None:
        self._autopilot.send(message.pack(self._codec))

    def evidence(self) -> FlightEvidence:
        """Return what went to and from the follower."""
        evidence = FlightEvidence(self.flavour)
        evidence.read(self._follower.received, self._follower.sent, self._system)
        return evidence

    def close(self) -> None:
        """Close the follower's side."""
        self._follower.close()
