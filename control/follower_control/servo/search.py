"""Looking for a target that was lost."""

import math
from dataclasses import dataclass

from follower_control.common.strict_config import check_ranges
from follower_control.target.estimate import TargetEstimate, azimuth_of
from follower_control.target.observation import BearingFrame
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_control.vehicle.state import VehicleState
from follower_vision.geometry.camera_model import Vector
from follower_vision.geometry.line_of_sight import wrap_angle

_GAIN_PER_S = 1.5
_REACHED_RAD = math.radians(3)
_SWEEP_GAIN_PER_S = 3.0
_SURELY = 0.7
"""What share of the view counts: nearer to its border a target is cut or gone at once."""

_AHEAD_S = 1.0
_FARTHEST_AHEAD_RAD = math.radians(30)
_STALE_S = 0.5


@dataclass(frozen=True, slots=True)
class SearchSettings:
    """How to look for a lost target.

    Attributes:
        turn: whether to turn at all; else the vehicle stands still.
        turn_rate_deg_s: largest yaw rate.
        look_s: how long to look at where the target left before looking elsewhere.
        stay_s: look there for so much longer while all places where it may be are seen from there.
        sweep_deg: then look so far to the side where it left, as far to the other one, twice as
            far, and so on; 0 stays.
        climb_m: climb by so much meanwhile, to see more.
        climb_m_s: and so fast.
    """

    turn: bool = True
    turn_rate_deg_s: float = 20.0
    look_s: float = 2.0
    stay_s: float = 0.0
    sweep_deg: float = 20.0
    climb_m: float = 0.0
    climb_m_s: float = 1.0

    def __post_init__(self) -> None:
        check_ranges(
            self,
            turn_rate_deg_s=(0.01, 90),
            look_s=(0, 3600),
            stay_s=(0, 3600),
            sweep_deg=(0, 180),
            climb_m=(0, 100),
            climb_m_s=(0.01, 5),
        )


class Search:
    """Turns to where the target left, then looks ever farther to both sides of that.

    Once the target may be on every side it turns round and round.

    Args:
        settings: how to look.
        view_rad: how wide the camera sees.

    Needs headings: with an estimate in the body's frame, or without fresh telemetry, it holds.
    """

    def __init__(self, settings: SearchSettings, view_rad: float = math.radians(70)) -> None:
        self._seen_rad = _SURELY * view_rad / 2
        self.change(settings)
        self._centre_rad: float | None = None
        self._side = 1.0
        self._leg = 0
        self._looked_s: float | None = None
        self._top_m: float | None = None
        self._right_rad = self._left_rad = 0.0

    def change(self, settings: SearchSettings) -> None:
        """Go on by other settings; how far to climb counts from the next start on."""
        self._settings = settings
        self._rate = math.radians(settings.turn_rate_deg_s)
        self._sweep = math.radians(settings.sweep_deg)

    def start(self, last: TargetEstimate | None, vehicle: VehicleState) -> None:
        """Begin where the target was last believed to be."""
        self._centre_rad, self._leg, self._looked_s = None, 0, None
        self._right_rad = self._left_rad = 0.0
        position = vehicle.position
        self._top_m = None if position is None else position.height_m + self._settings.climb_m
        if last is None or last.frame is BearingFrame.BODY or vehicle.attitude is None:
            return
        ahead = 0.0 if last.frame is BearingFrame.DOWN else _AHEAD_S * last.azimuth_rate_rad_s
        ahead = min(max(ahead, -_FARTHEST_AHEAD_RAD), _FARTHEST_AHEAD_RAD)
        self._centre_rad = wrap_angle(azimuth_of(last) + ahead)
        off = wrap_angle(self._centre_rad - vehicle.attitude.yaw_rad)
        self._side = math.copysign(1.0, off)

    def aim(self, target: TargetEstimate) -> None:
        """Turn on with where the target is believed to be by now, until that was looked at.

        Then the side to which it moves comes first.
        """
        if self._leg == 0 and target.frame is BearingFrame.WORLD:
            self._centre_rad = target.azimuth_rad
            self._side = math.copysign(1.0, target.azimuth_rate_rad_s)

    def spread(self, azimuths_rad: Vector | None) -> None:
        """Look so far to either side that all of these azimuths, (N,) rad from north, are seen."""
        if azimuths_rad is None or self._centre_rad is None or len(azimuths_rad) == 0:
            return
        self._left_rad, self._right_rad = _sides(self._centre_rad, azimuths_rad)

    def update(self, vehicle: VehicleState, now_s: float) -> VelocitySetpoint:
        """Return the setpoint for now; whatever is not known is not moved by."""
        return VelocitySetpoint(
            down_m_s=-self._climb(vehicle, now_s), yaw_rate_rad_s=self._turn(vehicle, now_s)
        )

    def _turn(self, vehicle: VehicleState, now_s: float) -> float:
        stale = vehicle.attitude_age_s(now_s) > _STALE_S
        if self._centre_rad is None or vehicle.attitude is None or stale or not self._settings.turn:
            return HOLD.yaw_rate_rad_s
        if self._leg > 0 and self._is_anywhere:
            return math.copysign(self._rate, self._wanted_off_rad)
        # To the other side it turns by way of the middle, however far the sides are apart.
        off = wrap_angle(vehicle.attitude.yaw_rad - self._centre_rad)
        error = self._wanted_off_rad - off
        if abs(error) <= _REACHED_RAD:
            self._arrive(now_s)
        gain = _GAIN_PER_S if self._leg == 0 else _SWEEP_GAIN_PER_S
        return min(max(gain * error, -self._rate), self._rate)

    def _arrive(self, now_s: float) -> None:
        """Go on to the next side, from the middle only after a look."""
        if self._looked_s is None:
            self._looked_s = now_s
        s = self._settings
        all_in_view = 0 < max(self._right_rad, self._left_rad) <= self._seen_rad
        look_s = s.look_s + s.stay_s if self._leg == 0 and all_in_view else s.look_s
        if self._sweep > 0 and now_s - self._looked_s >= look_s:
            self._leg += 1

    @property
    def _is_anywhere(self) -> bool:
        """Whether it may be on every side: one turn round sees all of them, to and fro may not."""
        return self._right_rad + self._left_rad >= 2 * (math.pi - self._seen_rad)

    @property
    def _wanted_off_rad(self) -> float:
        """How far from the middle to look now."""
        if self._leg == 0:
            return 0.0
        side = self._side if self._leg % 2 else -self._side
        may_be = self._right_rad if side > 0 else self._left_rad
        far = may_be - self._seen_rad
        far = max(far, self._sweep * ((self._leg + 1) // 2))
        return side * min(far, math.pi - self._seen_rad)

    def _climb(self, vehicle: VehicleState, now_s: float) -> float:
        position = vehicle.position
        if position is None or self._top_m is None or vehicle.position_age_s(now_s) > _STALE_S:
            return 0.0
        left_m = self._top_m - position.height_m
        if self._settings.climb_m == 0 or left_m <= 0:
            return 0.0
        return min(self._settings.climb_m_s, left_m)


def _sides(heading_rad: float, azimuths_rad: Vector) -> tuple[float, float]:
    """Return how far azimuths reach to the left and to the right of a heading, not negative."""
    off = [wrap_angle(float(azimuth) - heading_rad) for azimuth in azimuths_rad]
    return max(-min(off), 0.0), max(*off, 0.0)
