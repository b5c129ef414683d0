"""Whether the vehicle is well enough to follow with: battery, estimator, GPS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from pymavlink.dialects.v20 import common as mavlink

from follower.links.vehicle_health import EstimatorHealth, VehicleHealth

_NEEDED = mavlink.ESTIMATOR_ATTITUDE | mavlink.ESTIMATOR_VELOCITY_HORIZ
_PLACED = mavlink.ESTIMATOR_POS_HORIZ_REL | mavlink.ESTIMATOR_POS_HORIZ_ABS
"""These bits are the same in ESTIMATOR_STATUS and EKF_STATUS_REPORT."""


@dataclass(frozen=True, slots=True)
class HealthSettings:
    """What is asked of the vehicle's health.

    Attributes:
        battery_to_start: smallest share of the battery with which following begins.
        battery_to_go_on: smallest share with which it goes on.
        gps_fix: smallest GPS_FIX_TYPE; 3 is a position in space. None flies without GPS.
        largest_ratio: largest innovation of velocity and horizontal position over its limit.
        stale_s: what was told longer ago does not count any more.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    battery_to_start: float = 0.3
    battery_to_go_on: float = 0.2
    gps_fix: int | None = 3
    largest_ratio: float = 1.0
    stale_s: float = 5.0

    def __post_init__(self) -> None:
        if not 0 <= self.battery_to_go_on <= self.battery_to_start <= 1:
            raise ValueError("0 <= battery_to_go_on <= battery_to_start <= 1 does not hold")
        if not (self.largest_ratio > 0 and self.stale_s > 0):
            raise ValueError("largest_ratio and stale_s are positive")


@dataclass(frozen=True, slots=True)
class HealthVerdict:
    """What the vehicle's health allows.

    Attributes:
        battery_low: too little is left.
        navigation_poor: the autopilot does not know well where it is, or how it moves.
    """

    battery_low: bool = False
    navigation_poor: bool = False


def judge(
    health: VehicleHealth, settings: HealthSettings, engaged: bool, now_s: float
) -> HealthVerdict:
    """Return the verdict; what was never told, or long ago, is no objection. Pure.

    Args:
        health: what the vehicle told.
        settings: what is asked.
        engaged: whether following has begun; less battery is enough to go on.
        now_s: the present.
    """
    sensors, gps, estimator = health.sensors, health.gps, health.estimator
    least = settings.battery_to_go_on if engaged else settings.battery_to_start
    low = False
    if sensors is not None and now_s - sensors.time_s <= settings.stale_s:
        low = sensors.battery_share is not None and sensors.battery_share < least
    poor = False
    if gps is not None and now_s - gps.time_s <= settings.stale_s:
        poor = settings.gps_fix is not None and gps.fix_type < settings.gps_fix
    if estimator is not None and now_s - estimator.time_s <= settings.stale_s:
        poor = poor or _is_poor(estimator, settings.largest_ratio)
    return HealthVerdict(low, poor)


def _is_poor(estimator: EstimatorHealth, largest_ratio: float) -> bool:
    flags = estimator.flags
    knows = flags & _NEEDED == _NEEDED and bool(flags & _PLACED)
    lost = bool(flags & mavlink.ESTIMATOR_CONST_POS_MODE) or estimator.gps_glitch
    ratio = max(estimator.velocity_ratio, estimator.horizontal_ratio)
    return not knows or lost or not ratio <= largest_ratio
