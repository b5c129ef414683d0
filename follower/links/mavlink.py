"""The pymavlink link: our own stream of setpoints."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import common as mavlink

from follower.links.autopilot_link import AutopilotLink
from follower.links.vehicle_finder import Vehicle
from follower_control.setpoint import VelocitySetpoint

VELOCITY_AND_YAW_RATE = 0x5C7
"""Position, acceleration and yaw ignored. The one mask that both autopilots fly: a setpoint
without a yaw rate makes ArduCopter turn its nose into the velocity."""


class MavlinkLink(AutopilotLink):
    """A companion computer's end of a MAVLink 2 link to one autopilot.

    It knows no threads and no clock: when the control loop stands still, nothing is sent. See
    `Link`.
    """

    kind = "pymavlink"

    def arm(self) -> None:
        """Ask the autopilot to arm."""
        self._command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    def take_off(self, height_m: float) -> None:
        """Ask for a take-off to `height_m` above the ground the vehicle stands on."""
        # PX4 takes an altitude above mean sea level, ArduCopter one above home.
        if self.autopilot_name != "px4":
            # Of NaN as a place older ArduPilot SITLs die by a floating point exception.
            self._command(mavlink.MAV_CMD_NAV_TAKEOFF, *(0.0,) * 6, height_m)
            return
        nan = math.nan
        above = nan if self.altitude_msl_m is None else self.altitude_msl_m + height_m
        self._command(mavlink.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, nan, nan, nan, above)

    def _receive(self, now_s: float) -> None:
        for packet in self._channel.receive(now_s):
            if self._is_vehicles(packet):
                self._sequence.count(packet.sequence)
                if not packet.is_known or self._take_health(packet, now_s):
                    continue
                message = self._unpacker.message(packet)
                self._take(message.get_type(), message, now_s)
            else:
                self._hear_stranger(packet, now_s)

    def _send_setpoint(self, setpoint: VelocitySetpoint, vehicle: Vehicle) -> None:
        forward, right, down, yaw_rate = setpoint.values
        self._send_message(
            mavlink.MAVLink_set_position_target_local_ned_message(
                0 if self._monitor is None else self._monitor.boot_ms,
                vehicle.system,
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

    def _command(self, command: int, *params: float) -> None:
        if self._vehicle is None:
            return
        padded = params + (0.0,) * (7 - len(params))
        self._send_message(
            mavlink.MAVLink_command_long_message(
                self._vehicle.system, mavlink.MAV_COMP_ID_AUTOPILOT1, command, 0, *padded
            )
        )

    def _send_parameter_request(self, name: str) -> None:
        if self._vehicle is not None:
            target = self._vehicle.system, mavlink.MAV_COMP_ID_AUTOPILOT1
            self._send_message(
                mavlink.MAVLink_param_request_read_message(*target, name.encode(), -1)
            )

    def _send_timesync(self, tc1: int, ts1: int) -> None:
        self._send_message(mavlink.MAVLink_timesync_message(tc1, ts1))
