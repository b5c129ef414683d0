"""Takes in what the vehicle says about its health, its firmware and its parameters."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from follower.links import ekf_status_report
from follower.links.packets import Packet
from follower.links.parameter_reader import ParameterReader
from follower.links.unpacking import Unpacker
from follower.links.vehicle_finder import Vehicle
from follower.links.vehicle_health import (
    EstimatorHealth,
    GpsHealth,
    SensorHealth,
    VehicleHealth,
)

_UNKNOWN_8, _UNKNOWN_16 = 0xFF, 0xFFFF
_ARDUPILOT_GLITCH = 1 << 15


class HealthMonitor:
    """Reads packets by itself, so that both links learn the same.

    Args:
        vehicle: whose packets they are; the caller has made sure of that.

    Attributes:
        health: the newest of everything.
        parameters: those that were asked for.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self.health = VehicleHealth()
        self.parameters = ParameterReader(vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4)
        self._unpacker = Unpacker()
        self._handlers: dict[int, Callable[[Any, float], None]] = {
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._on_heartbeat,
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: self._on_sys_status,
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._on_gps,
            mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: self._on_estimator,
            mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: self._on_version,
            mavlink.MAVLINK_MSG_ID_PARAM_VALUE: self._on_parameter,
        }

    def take(self, packet: Packet, now_s: float) -> str | None:
        """Take one packet; return the name of its message if it is one of health."""
        if packet.message_id == ekf_status_report.MESSAGE_ID:
            self._on_ekf(ekf_status_report.decode(packet.data), now_s)
            return ekf_status_report.NAME
        handler = self._handlers.get(packet.message_id)
        if handler is None:
            return None
        message = self._unpacker.message(packet)
        handler(message, now_s)
        return str(message.get_type())

    def _on_heartbeat(self, message: Any, _now_s: float) -> None:
        self.health = replace(self.health, vehicle_type=message.type)

    def _on_sys_status(self, m: Any, now_s: float) -> None:
        percent = m.battery_remaining
        sensors = SensorHealth(
            m.onboard_control_sensors_enabled,
            m.onboard_control_sensors_health,
            percent / 100 if 0 <= percent <= 100 else None,
            now_s,
        )
        self.health = replace(self.health, sensors=sensors)

    def _on_gps(self, m: Any, now_s: float) -> None:
        satellites = None if m.satellites_visible == _UNKNOWN_8 else m.satellites_visible
        hdop = None if m.eph == _UNKNOWN_16 else m.eph / 100
        self.health = replace(self.health, gps=GpsHealth(m.fix_type, satellites, hdop, now_s))

    def _on_estimator(self, m: Any, now_s: float) -> None:
        glitch = bool(m.flags & mavlink.ESTIMATOR_GPS_GLITCH)
        ratios = m.vel_ratio, m.pos_horiz_ratio, m.pos_vert_ratio, m.mag_ratio
        self._set_estimator(m.flags, ratios, glitch, now_s)

    def _on_ekf(self, m: ekf_status_report.EkfStatusReport, now_s: float) -> None:
        glitch = bool(m.flags & _ARDUPILOT_GLITCH)
        ratios = m.velocity_variance, m.pos_horiz_variance, m.pos_vert_variance, m.compass_variance
        self._set_estimator(m.flags, ratios, glitch, now_s)

    def _set_estimator(
        self, flags: int, ratios: tuple[float, float, float, float], glitch: bool, now_s: float
    ) -> None:
        # PX4 says NaN of what it does not use.
        a, b, c, d = (0.0 if math.isnan(ratio) else ratio for ratio in ratios)
        self.health = replace(
            self.health, estimator=EstimatorHealth(flags, a, b, c, d, glitch, now_s)
        )

    def _on_version(self, m: Any, _now_s: float) -> None:
        packed = m.flight_sw_version
        version = packed >> 24 & 0xFF, packed >> 16 & 0xFF, packed >> 8 & 0xFF
        self.health = replace(self.health, firmware=version)

    def _on_parameter(self, m: Any, _now_s: float) -> None:
        self.parameters.take(m.param_id, m.param_value, m.param_type)
