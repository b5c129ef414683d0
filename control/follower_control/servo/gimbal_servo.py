"""The law that keeps the target in the middle of a gimbal's camera."""

import math
from dataclasses import dataclass

from follower_control.common.small_matrix import clip
from follower_control.common.strict_config import check_positive, check_ranges
from follower_control.target.estimate import TargetEstimate
from follower_control.target.observation import BearingFrame
from follower_control.vehicle.gimbal import STILL, GimbalRates, camera_to_world
from follower_control.vehicle.history import turned_on
from follower_control.vehicle.state import Attitude, GimbalState
from follower_vision.geometry.line_of_sight import LineOfSight, wrap_angle

_STALE_S = 0.5
_AHEAD_S = 0.1
_STEEPEST_RAD = math.radians(85)


@dataclass(frozen=True, slots=True)
class GimbalSettings:
    """Whether the camera hangs in a gimbal, and how it is moved.

    Attributes:
        enabled: the camera hangs in a gimbal that the autopilot's gimbal manager moves.
        device: which gimbal, as the gimbal manager counts; 0 is the first, or all.
        gain_s: turning rate per angle off the middle.
        max_rate_deg_s: largest turning rate.
        lowest_deg: smallest pitch from the horizon.
        highest_deg: largest one.
        widest_deg: largest yaw from the nose, either way.
    """

    enabled: bool = False
    device: int = 0
    gain_s: float = 3.0
    max_rate_deg_s: float = 60.0
    lowest_deg: float = -90.0
    highest_deg: float = 25.0
    widest_deg: float = 150.0

    def __post_init__(self) -> None:
        check_ranges(self, device=(0, 255), widest_deg=(0.01, 360))
        check_positive(self, "gain_s", "max_rate_deg_s")
        if not -90 <= self.lowest_deg < self.highest_deg <= 90:
            raise ValueError("-90 <= lowest_deg < highest_deg <= 90 does not hold")


class GimbalServo:
    """Turns the camera after the target: its angular rate, and a share of the angle that is left.

    Rates are against the world, so that the vehicle's turning and tilting are the gimbal's
    business. Beyond its limits it asks for no more.
    """

    def __init__(self, settings: GimbalSettings) -> None:
        self._settings = settings
        self._most = math.radians(settings.max_rate_deg_s)

    def update(
        self,
        estimate: TargetEstimate | None,
        gimbal: GimbalState | None,
        vehicle: Attitude | None,
        now_s: float,
    ) -> GimbalRates:
        """Return the rates for `now_s` (seconds).

        Zero where the target or the gimbal is not known.
        """
        if estimate is None or gimbal is None or vehicle is None or not gimbal.is_finite:
            return STILL
        age_s = now_s - gimbal.time_s
        if estimate.frame is BearingFrame.BODY or not 0 <= age_s + _AHEAD_S <= _STALE_S + _AHEAD_S:
            return STILL
        ahead_s = min(max(age_s, 0.0), _AHEAD_S)
        now = GimbalState(turned_on(gimbal.attitude, ahead_s), gimbal.is_level, gimbal.from_north)
        forward = camera_to_world(now, vehicle)[:, 2]
        looks = LineOfSight.from_vector(forward)
        wanted = LineOfSight.from_vector(estimate.direction)
        turn = wrap_angle(wanted.azimuth_rad - looks.azimuth_rad)
        rise = wanted.elevation_rad - looks.elevation_rad
        in_world = estimate.frame is BearingFrame.WORLD
        yaw = (estimate.azimuth_rate_rad_s if in_world else 0.0) + self._settings.gain_s * turn
        pitch = (estimate.elevation_rate_rad_s if in_world else 0.0) + self._settings.gain_s * rise
        if abs(looks.elevation_rad) > _STEEPEST_RAD:
            yaw = 0.0
        return self._limited(pitch, yaw, looks, wrap_angle(looks.azimuth_rad - vehicle.yaw_rad))

    def _limited(
        self, pitch: float, yaw: float, looks: LineOfSight, from_nose: float
    ) -> GimbalRates:
        s = self._settings
        widest = math.radians(s.widest_deg)
        return GimbalRates(
            _inside(
                clip(pitch, self._most),
                looks.elevation_rad,
                math.radians(s.lowest_deg),
                math.radians(s.highest_deg),
            ),
            _inside(clip(yaw, self._most), from_nose, -widest, widest),
        )


def _inside(rate: float, angle: float, low: float, high: float) -> float:
    """Return the rate unless it leads farther out of the limits."""
    if (angle >= high and rate > 0) or (angle <= low and rate < 0):
        return 0.0
    return rate
