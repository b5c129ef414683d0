"""The pymavlink link: our own stream of setpoints."""

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from follower.links.link import AUTOPILOT_ID, Link
from follower.links.vehicle_finder import FoundVehicle
from follower_control.vehicle.setpoint import VelocitySetpoint

VELOCITY_AND_YAW_RATE = 0x5C7
"""Position, acceleration and yaw ignored. The one mask that both autopilots fly: a setpoint
without a yaw rate makes ArduCopter turn its nose into the velocity."""


class MavlinkLink(Link):
    """A companion computer's end of a MAVLink 2 link to one autopilot.

    It knows no threads and no clock: when the control loop stands still, nothing is sent.
    """

    kind = "pymavlink"

    def _receive(self, now_s: float) -> None:
        for packet in self._channel.receive(now_s):
            self._take(packet, now_s)

    def _send_setpoint(self, setpoint: VelocitySetpoint, vehicle: FoundVehicle) -> None:
        forward, right, down, yaw_rate = setpoint.values
        self._send_message(
            mavlink.MAVLink_set_position_target_local_ned_message(
                self._monitor.boot_ms,
                vehicle.system,
                AUTOPILOT_ID,
                mavlink.MAV_FRAME_BODY_NED,
                VELOCITY_AND_YAW_RATE,
                *(0.0, 0.0, 0.0),
                *(forward, right, down),
                *(0.0, 0.0, 0.0),
                0.0,
                yaw_rate,
            )
        )

    def _send_fields(self, name: str, fields: dict[str, Any]) -> None:
        message = getattr(mavlink, f"MAVLink_{name.lower()}_message")
        texts = {key: text.encode() for key, text in fields.items() if isinstance(text, str)}
        self._send_message(message(**{**fields, **texts}))
