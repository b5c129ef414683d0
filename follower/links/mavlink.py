"""The pymavlink link: telemetry in, velocity setpoints out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower.links.boot_time import BootTime
from follower.links.modes import hold_mode, mode_name, set_mode_params, setpoint_mode
from follower_control.setpoint import VelocitySetpoint
from follower_control.transport import Transport
from follower_control.vehicle import Attitude, LocalPosition, VehicleState

VELOCITY_AND_YAW_RATE = 0x5C7
"""Position, acceleration and yaw ignored. The one mask that both autopilots fly: a setpoint
without a yaw rate makes ArduCopter turn its nose into the velocity."""

WANTED_RATES_HZ = {
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 100.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 2.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
}

_HEARTBEAT_S = 1.0
_REQUEST_AGAIN_S = 3.0


class MavlinkLink:
    """A companion computer's end of a MAVLink 2 link to one autopilot.

    It is stepped by `poll` and knows no threads and no clock. Telemetry that is not finite is
    dropped, so that it grows stale instead of being believed.
    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self._codec = mavlink.MAVLink(None, 1, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER)
        self._codec.robust_parsing = True
        self._boot = BootTime()
        self._boot_now_ms = 0
        self._system: int | None = None
        self._autopilot = mavlink.MAV_AUTOPILOT_GENERIC
        self._last_heartbeat_s = -math.inf
        self._last_request_s = -math.inf
        self._notes: list[str] = []
        self._handlers: dict[str, Callable[[Any, float], None]] = {
            "ATTITUDE": self._on_attitude,
            "LOCAL_POSITION_NED": self._on_position,
            "GLOBAL_POSITION_INT": self._on_global_position,
            "EXTENDED_SYS_STATE": self._on_landed_state,
            "COMMAND_ACK": self._on_ack,
            "STATUSTEXT": self._on_text,
        }
        self.state = VehicleState()
        self.altitude_msl_m: float | None = None
        self.attitudes: list[Attitude] = []

    @property
    def connected(self) -> bool:
        """Whether an autopilot was heard."""
        return self._system is not None

    @property
    def autopilot_name(self) -> str:
        """What kind of autopilot answers: "px4", "ardupilot" or "unknown"."""
        names = {mavlink.MAV_AUTOPILOT_PX4: "px4", mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ardupilot"}
        return names.get(self._autopilot, "unknown")

    def poll(self, now_s: float) -> None:
        """Take in what has arrived and send what is due; `attitudes` holds the new ones."""
        self.attitudes = []
        for message in self._codec.parse_buffer(self._transport.receive()) or []:
            self._take(message, now_s)
        if now_s - self._last_heartbeat_s >= _HEARTBEAT_S and self.connected:
            self._last_heartbeat_s = now_s
            self._send_heartbeat()
        if now_s - self._last_request_s >= _REQUEST_AGAIN_S and self._rates_missing(now_s):
            self._last_request_s = now_s
            self._request_rates()

    def take_notes(self) -> list[str]:
        """Return the autopilot's texts and refusals since the last call."""
        notes, self._notes = self._notes, []
        return notes

    def send(self, setpoint: VelocitySetpoint) -> None:
        """Send one velocity setpoint.

        Raises:
            ValueError: a number is not finite. The envelope never lets that come so far.
        """
        if not setpoint.is_finite:
            raise ValueError(f"a setpoint that is not finite never leaves: {setpoint}")
        if self._system is None:
            return
        forward, right, down, yaw_rate = setpoint.values
        self._send(
            mavlink.MAVLink_set_position_target_local_ned_message(
                self._boot_now_ms,
                self._system,
                mavlink.MAV_COMP_ID_AUTOPILOT1,
                mavlink.MAV_FRAME_BODY_NED,
                VELOCITY_AND_YAW_RATE,
                *(0.0, 0.0, 0.0),
                *(forward, right, down),
                *(0.0, 0.0, 0.0),
                0.0,
                yaw_rate,
            )
        )

    def arm(self) -> None:
        """Ask the autopilot to arm."""
        self._command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    def take_off(self, height_m: float) -> None:
        """Ask for a take-off to `height_m` above the ground the vehicle stands on."""
        # PX4 takes an altitude above mean sea level, ArduCopter one above home.
        above = height_m
        if self._autopilot == mavlink.MAV_AUTOPILOT_PX4:
            above = math.nan if self.altitude_msl_m is None else self.altitude_msl_m + height_m
        nan = math.nan
        self._command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, nan, nan, nan, above)

    def enter_setpoint_mode(self) -> None:
        """Ask for OFFBOARD or GUIDED."""
        self._set_mode(setpoint_mode(self._autopilot))

    def enter_hold_mode(self) -> None:
        """Ask for the mode in which the autopilot stands still by itself."""
        self._set_mode(hold_mode(self._autopilot))

    def close(self) -> None:
        """Close the transport."""
        self._transport.close()

    def _take(self, message: Any, now_s: float) -> None:
        kind = message.get_type()
        if kind == "HEARTBEAT":
            self._on_heartbeat(message, now_s)
        elif message.get_srcSystem() == self._system and kind in self._handlers:
            self._handlers[kind](message, now_s)

    def _on_heartbeat(self, message: Any, now_s: float) -> None:
        if message.autopilot == mavlink.MAV_AUTOPILOT_INVALID:
            return  # a ground station, a camera, another companion
        if self._system is None:
            self._system = message.get_srcSystem()
            self._autopilot = message.autopilot
            self._codec.srcSystem = self._system
        if message.get_srcSystem() != self._system:
            return
        mode = mode_name(self._autopilot, message.custom_mode)
        self.state = replace(
            self.state,
            mode=mode,
            obeys_setpoints=mode == setpoint_mode(self._autopilot),
            armed=bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED),
            heartbeat_s=now_s,
        )

    def _on_attitude(self, message: Any, now_s: float) -> None:
        angles = (message.roll, message.pitch, message.yaw)
        rates = (message.rollspeed, message.pitchspeed, message.yawspeed)
        if not all(map(math.isfinite, angles + rates)):
            return
        attitude = Attitude(*angles, *rates, self._time_of(message, now_s))
        self.attitudes.append(attitude)
        self.state = replace(self.state, attitude=attitude)

    def _on_position(self, message: Any, now_s: float) -> None:
        numbers = (message.x, message.y, message.z, message.vx, message.vy, message.vz)
        if all(map(math.isfinite, numbers)):
            position = LocalPosition(*numbers, self._time_of(message, now_s))
            self.state = replace(self.state, position=position)

    def _on_global_position(self, message: Any, now_s: float) -> None:
        self._time_of(message, now_s)
        self.altitude_msl_m = message.alt / 1000.0

    def _on_landed_state(self, message: Any, _now_s: float) -> None:
        if message.landed_state != mavlink.MAV_LANDED_STATE_UNDEFINED:
            landed = message.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND
            self.state = replace(self.state, landed=landed)

    def _on_ack(self, message: Any, _now_s: float) -> None:
        if message.result not in (mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_IN_PROGRESS):
            command = mavlink.enums["MAV_CMD"].get(message.command)
            result = mavlink.enums["MAV_RESULT"].get(message.result)
            self._notes.append(
                f"{command.name if command else message.command}: "
                f"{result.name if result else message.result}"
            )

    def _on_text(self, message: Any, _now_s: float) -> None:
        self._notes.append(str(message.text))

    def _time_of(self, message: Any, now_s: float) -> float:
        self._boot_now_ms = message.time_boot_ms
        return self._boot.to_system(message.time_boot_ms / 1000.0, now_s)

    def _rates_missing(self, now_s: float) -> bool:
        stale = _REQUEST_AGAIN_S / 2
        return self.connected and (
            self.state.attitude_age_s(now_s) > stale
            or self.state.position_age_s(now_s) > stale
            or self.state.landed is None
        )

    def _request_rates(self) -> None:
        for message_id, rate_hz in WANTED_RATES_HZ.items():
            self._command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, float(message_id), 1e6 / rate_hz)

    def _send_heartbeat(self) -> None:
        # As a ground station's it would hide the loss of the real one.
        self._send(
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
                mavlink.MAV_AUTOPILOT_INVALID,
                0,
                0,
                mavlink.MAV_STATE_ACTIVE,
                3,
            )
        )

    def _set_mode(self, name: str) -> None:
        self._command(mavlink.MAV_CMD_DO_SET_MODE, *set_mode_params(self._autopilot, name))

    def _command(self, command: int, *params: float) -> None:
        if self._system is None:
            return
        padded = params + (0.0,) * (7 - len(params))
        self._send(
            mavlink.MAVLink_command_long_message(
                self._system, mavlink.MAV_COMP_ID_AUTOPILOT1, command, 0, *padded
            )
        )

    def _send(self, message: Any) -> None:
        data = message.pack(self._codec)
        self._codec.seq = (self._codec.seq + 1) % 256
        self._transport.send(data)
