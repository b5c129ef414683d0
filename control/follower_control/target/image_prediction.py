"""Where a target can be, seen from us, and where in an image that is."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from follower_control.common.small_matrix import length
from follower_control.target.observation import BearingObserver
from follower_control.vehicle.gimbal import GimbalHistory
from follower_control.vehicle.history import AttitudeHistory
from follower_vision.geometry.box import Box
from follower_vision.geometry.camera_model import Vector
from follower_vision.trackers.target_tracker import MotionForecast, TargetPrediction

_NEAREST_SHARE = 0.2
_UP_SHARE = 0.5


def _directions(count: int) -> Vector:
    """Return unit vectors all around, (2, count): away from us, and to the right."""
    angles = [number * math.tau / count for number in range(count)]
    return np.array([[math.cos(angle) for angle in angles], [math.sin(angle) for angle in angles]])


_ROUND, _CROSS = _directions(12), _directions(4)
"""Directions to the places about one: enough for a region, and for how far off it may be."""

_ANGLE_RAD, _TIME_S = math.radians(2.0), 0.05
"""What attitude and lens may be wrong by, and the time for which the attitude was taken."""


@dataclass(frozen=True, slots=True, eq=False)
class PredictedRegion:
    """Where a target can be at a time.

    Attributes:
        away_m: (3,) north, east, down from us to where it should be.
        likely_m: how far from there it mostly is; up and down, half as far.
        possible_m: how far from there it can be.
        seen_s: when it was seen last.
        nearer: how many times as near it should be as it was then.
        from_m: (3,) where we are then.
    """

    away_m: Vector
    likely_m: float
    possible_m: float
    seen_s: float = -math.inf
    nearer: float = 1.0
    from_m: Vector = field(default_factory=lambda: np.zeros(3))

    def points_m(self, reach_m: float, angle_rad: float = 0.0, around: Vector = _ROUND) -> Vector:
        """Return (N + 3, 3): where it should be, and places around that, above and below.

        No point comes as near to us as a fifth of the distance: what is so near is all around.

        Args:
            reach_m: how far.
            angle_rad: what directions may be wrong by; comes on top.
            around: (2, N) directions from there: away from us, and to the right.
        """
        distance_m = length(self.away_m)
        level_m = math.hypot(self.away_m[0], self.away_m[1])
        ahead = np.array([self.away_m[0], self.away_m[1], 0.0]) / max(level_m, 1e-6)
        across = np.array([-ahead[1], ahead[0], 0.0])
        slack_m = angle_rad * distance_m
        up = np.array([0.0, 0.0, _UP_SHARE * reach_m + slack_m])
        nearest_m = min(level_m, _NEAREST_SHARE * distance_m)
        along_m = np.maximum(level_m + (reach_m + slack_m) * around[0], nearest_m)
        across_m = (reach_m + slack_m) * around[1]
        circle = along_m[:, None] * ahead + across_m[:, None] * across
        circle[:, 2] = self.away_m[2]
        return np.vstack([self.away_m, circle, self.away_m + up, self.away_m - up])


def prospect(
    outlook: PredictedRegion,
    sighter: BearingObserver,
    captured_s: float,
    attitudes: AttitudeHistory,
    gimbal: GimbalHistory | None = None,
    earlier: Sequence[PredictedRegion] = (),
) -> TargetPrediction | None:
    """Return where in an image the target can be; None where the camera's direction is not known.

    Args:
        outlook: for the time at which the image was taken.
        sighter: knows the camera.
        captured_s: the image's time stamp.
        attitudes: of the vehicle.
        gimbal: which holds the camera, if one does.
        earlier: for the same time, by what was believed before.
    """
    time_s = sighter.exposed_s(captured_s)
    attitude = attitudes.at(time_s)
    if attitude is None:
        return None
    held = None if gimbal is None else gimbal.at(time_s)
    turning = attitude if held is None else held.attitude
    angle_rad = _ANGLE_RAD + _TIME_S * turning.turn_rate_rad_s
    reaches = (outlook.likely_m, outlook.possible_m)
    likely, possible = (outlook.points_m(reach_m, angle_rad) for reach_m in reaches)
    before = [one.points_m(one.likely_m, angle_rad, _CROSS) for one in earlier]
    places = [likely, possible, *before]
    view = sighter.view(captured_s, outlook.from_m, attitudes, gimbal)
    if view is None:
        return None
    view = replace(view, angle_rad=angle_rad)
    offset_s = captured_s - time_s
    seen = np.split(
        view.pixels(np.concatenate(places)), np.cumsum([len(one) for one in places])[:-1]
    )
    forecasts = tuple(
        MotionForecast(one.seen_s + offset_s, *_middle(places), _about(places), one.nearer)
        for one, places in zip(earlier, seen[2:], strict=True)
    )
    around = _about(seen[0]), _about(seen[1])
    return TargetPrediction(*_middle(seen[0]), *around, forecasts, length(outlook.away_m), view)


def _middle(pixels: Vector) -> tuple[float, float]:
    x, y = pixels[0].tolist()
    return x, y


def _about(pixels: Vector) -> Box:
    (left, top), (right, bottom) = pixels.min(axis=0).tolist(), pixels.max(axis=0).tolist()
    width, height = max(right - left, 1.0), max(bottom - top, 1.0)
    return Box((left + right) / 2, (top + bottom) / 2, width, height)
