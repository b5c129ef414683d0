"""How well the simulated autopilot says that it is: sensors, battery, GPS and estimator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega
from pymavlink.dialects.v20 import common as mavlink

ESTIMATES_ALL = 0x33F
"""Attitude, velocities, positions: what both estimators claim with a GPS, on the ground too."""

_SENSORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
    | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
    | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
    | mavlink.MAV_SYS_STATUS_SENSOR_GPS
    | mavlink.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
    | mavlink.MAV_SYS_STATUS_AHRS
    | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
    | mavlink.MAV_SYS_STATUS_PREARM_CHECK
)


@dataclass(slots=True)
class Health:
    """What the autopilot says of itself; a test or a scenario may change it during the flight.

    Attributes:
        unhealthy: MAV_SYS_STATUS_SENSOR bits of what is not well.
        battery_percent: what is left, -1 if the autopilot cannot tell.
        fix_type: GPS_FIX_TYPE.
        satellites: in use.
        hdop: horizontal dilution of precision.
        estimates: flags of the estimator's report (the low bits are the same for both).
        test_ratio: innovation over its limit, of all measurements; above 1 they are rejected.
        settled_s: when its estimator has a position, on the simulation's clock. Before that it
            tells no place and does not arm, as a real autopilot does not for up to a minute after
            its start.
        fit_s: when it has nothing else against being armed.
        has_rangefinder: one looks down and tells the distance to level ground.
    """

    unhealthy: int = 0
    battery_percent: int = 90
    fix_type: int = 3
    satellites: int = 12
    hdop: float = 0.8
    estimates: int = ESTIMATES_ALL
    test_ratio: float = 0.1
    settled_s: float = -math.inf
    fit_s: float = -math.inf
    has_rangefinder: bool = False

    def sys_status(self) -> Any:
        """Return SYS_STATUS."""
        battery = (15800, -1, self.battery_percent)
        well = _SENSORS & ~self.unhealthy
        return mavlink.MAVLink_sys_status_message(
            *(_SENSORS, _SENSORS, well), 300, *battery, *(0, 0, 0, 0, 0, 0)
        )

    def gps_raw_int(self, time_us: int, place: tuple[float, float, float]) -> Any:
        """Return GPS_RAW_INT at (latitude, longitude, height) in degrees and metres."""
        latitude, longitude, height_m = place
        return mavlink.MAVLink_gps_raw_int_message(
            time_us,
            self.fix_type,
            round(latitude * 1e7),
            round(longitude * 1e7),
            round(height_m * 1000.0),
            round(100 * self.hdop),
            round(150 * self.hdop),
            *(0, 0),
            self.satellites,
        )

    def estimator_status(self, time_us: int) -> Any:
        """Return ESTIMATOR_STATUS, which PX4 sends."""
        ratios = (self.test_ratio,) * 4
        return mavlink.MAVLink_estimator_status_message(
            time_us, self.estimates, *ratios, 0.0, 0.0, 0.4, 0.6
        )

    def ekf_status_report(self) -> Any:
        """Return EKF_STATUS_REPORT, which ArduPilot sends."""
        ratios = (self.test_ratio,) * 4
        return ardupilotmega.MAVLink_ekf_status_report_message(self.estimates, *ratios, 0.0)
