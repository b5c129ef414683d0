"""What the vehicle says about its own health, its firmware and its kind."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SensorHealth:
    """SYS_STATUS; the three are bit masks of MAV_SYS_STATUS_SENSOR.

    Attributes:
        enabled: what is used.
        healthy: what is well.
        battery_share: what is left of the battery, 0 to 1, None if the autopilot cannot tell.
        time_s: when it came.
    """

    enabled: int
    healthy: int
    battery_share: float | None
    time_s: float

    @property
    def unhealthy(self) -> int:
        """What is used and not well."""
        return self.enabled & ~self.healthy


@dataclass(frozen=True, slots=True)
class GpsHealth:
    """GPS_RAW_INT.

    Attributes:
        fix_type: GPS_FIX_TYPE: 3 is a position in space, more is better.
        satellites: in view, None if unknown.
        hdop: horizontal dilution of precision, None if unknown.
        time_s: when it came.
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
        time_s: when it came.
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
    """The newest of each; None is what was never told.

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
