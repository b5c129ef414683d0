"""What the vehicle reports about its own health, its firmware and its kind."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

_UNKNOWN_8, _UNKNOWN_16 = 0xFF, 0xFFFF
_ARDUPILOT_GLITCH = 1 << 15


@dataclass(frozen=True, slots=True)
class SensorHealth:
    """SYS_STATUS; the three are bit masks of MAV_SYS_STATUS_SENSOR.

    Attributes:
        enabled: what is used.
        healthy: what works.
        battery_share: what is left of the battery, 0 to 1, None if the autopilot does not know.
        time_s: when it came, seconds on the system's clock.
    """

    enabled: int
    healthy: int
    battery_share: float | None
    time_s: float

    @property
    def unhealthy(self) -> int:
        """What is used and does not work."""
        return self.enabled & ~self.healthy


@dataclass(frozen=True, slots=True)
class GpsHealth:
    """GPS_RAW_INT.

    Attributes:
        fix_type: GPS_FIX_TYPE: 3 is a position in space, more is better.
        satellites: in view, None if unknown.
        hdop: horizontal dilution of precision, None if unknown.
        time_s: when it came, seconds on the system's clock.
    """

    fix_type: int
    satellites: int | None
    hdop: float | None
    time_s: float


@dataclass(frozen=True, slots=True)
class EstimatorHealth:
    """ESTIMATOR_STATUS of PX4 or EKF_STATUS_REPORT of ArduPilot.

    The flags for attitude, velocities, positions and constant-position mode are the same bits in
    both (ESTIMATOR_STATUS_FLAGS and EKF_STATUS_FLAGS).

    Attributes:
        flags: what is estimated, as the message has it.
        velocity_ratio, horizontal_ratio, vertical_ratio, compass_ratio: innovation over its limit;
            above 1 the measurement is rejected.
        gps_glitch: GPS jumps.
        time_s: when it came, seconds on the system's clock.
    """

    flags: int
    velocity_ratio: float
    horizontal_ratio: float
    vertical_ratio: float
    compass_ratio: float
    gps_glitch: bool
    time_s: float

    @property
    def ratios(self) -> dict[str, float]:
        """The four ratios by what they are of."""
        return {
            "velocity": self.velocity_ratio,
            "horizontal position": self.horizontal_ratio,
            "height": self.vertical_ratio,
            "compass": self.compass_ratio,
        }


@dataclass(frozen=True, slots=True)
class VehicleHealth:
    """The newest of each; None is what was never reported.

    Attributes:
        vehicle_type: MAV_TYPE.
        firmware: major, minor and patch version.
        sensors: see there.
        gps: see there.
        estimator: see there.
    """

    vehicle_type: int | None = None
    firmware: tuple[int, int, int] | None = None
    sensors: SensorHealth | None = None
    gps: GpsHealth | None = None
    estimator: EstimatorHealth | None = None


class HealthMonitor:
    """Reads the vehicle's messages about its health.

    Attributes:
        health: the newest of everything.
    """

    def __init__(self) -> None:
        self.health = VehicleHealth()

    def take(self, name: str, m: Any, now_s: float) -> None:
        """Take any message by its MAVLink name, received at `now_s` in seconds."""
        match name:
            case "HEARTBEAT":
                self.health = replace(self.health, vehicle_type=m.type)
            case "SYS_STATUS":
                self.health = replace(self.health, sensors=_sensors(m, now_s))
            case "GPS_RAW_INT":
                satellites = None if m.satellites_visible == _UNKNOWN_8 else m.satellites_visible
                hdop = None if m.eph == _UNKNOWN_16 else m.eph / 100
                gps = GpsHealth(m.fix_type, satellites, hdop, now_s)
                self.health = replace(self.health, gps=gps)
            case "ESTIMATOR_STATUS":
                glitch = bool(m.flags & mavlink.ESTIMATOR_GPS_GLITCH)
                ratios = m.vel_ratio, m.pos_horiz_ratio, m.pos_vert_ratio, m.mag_ratio
                estimator = _estimator(m.flags, ratios, glitch, now_s)
                self.health = replace(self.health, estimator=estimator)
            case "EKF_STATUS_REPORT":
                # What ArduPilot calls variances are innovations over their limits.
                horizontal, vertical = m.pos_horiz_variance, m.pos_vert_variance
                ratios = m.velocity_variance, horizontal, vertical, m.compass_variance
                glitch = bool(m.flags & _ARDUPILOT_GLITCH)
                estimator = _estimator(m.flags, ratios, glitch, now_s)
                self.health = replace(self.health, estimator=estimator)
            case "AUTOPILOT_VERSION":
                packed = m.flight_sw_version
                version = packed >> 24 & 0xFF, packed >> 16 & 0xFF, packed >> 8 & 0xFF
                self.health = replace(self.health, firmware=version)


def _sensors(m: Any, now_s: float) -> SensorHealth:
    percent = m.battery_remaining
    share = percent / 100 if 0 <= percent <= 100 else None
    enabled, healthy = m.onboard_control_sensors_enabled, m.onboard_control_sensors_health
    return SensorHealth(enabled, healthy, share, now_s)


def _estimator(flags: int, ratios: Sequence[float], glitch: bool, now_s: float) -> EstimatorHealth:
    # PX4 sends NaN for what it does not use.
    a, b, c, d = (0.0 if math.isnan(ratio) else ratio for ratio in ratios)
    return EstimatorHealth(flags, a, b, c, d, glitch, now_s)
