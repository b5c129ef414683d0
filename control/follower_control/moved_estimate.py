"""What an estimate of the target is at another time, and from where we are now."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from follower_control.estimate import TargetEstimate
from follower_control.sighting import SightFrame
from follower_vision.camera import Vector
from follower_vision.lineofsight import wrap_angle

_NEAREST_M = 0.1


def seen_again(estimate: TargetEstimate) -> TargetEstimate:
    """Return the estimate for the moment of the last sighting, from which it was predicted."""
    age_s = estimate.age_s
    return replace(
        estimate,
        time_s=estimate.last_seen_s,
        azimuth_rad=wrap_angle(estimate.azimuth_rad - age_s * estimate.azimuth_rate_rad_s),
        elevation_rad=estimate.elevation_rad - age_s * estimate.elevation_rate_rad_s,
        log_scale=estimate.log_scale - age_s * estimate.log_scale_rate_s,
    )


def seen_from(
    estimate: TargetEstimate, away_m: Vector, rate_m_s: Vector, size_m: float
) -> TargetEstimate:
    """Return the estimate of a target that is so far away and moves so against us.

    Args:
        estimate: whose frame, time and covariance are kept; of the world.
        away_m: (3,) from us to the target, north, east, down.
        rate_m_s: (3,) its rate.
        size_m: the target's size.
    """
    ahead, right, down = _turned(away_m, estimate.frame)
    ahead_rate, right_rate, down_rate = _turned(rate_m_s, estimate.frame)
    level = max(math.hypot(ahead, right), _NEAREST_M)
    range2 = level * level + down * down
    level_rate = (ahead * ahead_rate + right * right_rate) / level
    return TargetEstimate(
        time_s=estimate.time_s,
        azimuth_rad=math.atan2(right, ahead),
        elevation_rad=math.atan2(-down, level),
        log_scale=math.log(size_m) - math.log(range2) / 2,
        azimuth_rate_rad_s=(ahead * right_rate - right * ahead_rate) / level**2,
        elevation_rate_rad_s=(down * level_rate - level * down_rate) / range2,
        log_scale_rate_s=-(level * level_rate + down * down_rate) / range2,
        covariance=estimate.covariance,
        last_seen_s=estimate.last_seen_s,
        frame=estimate.frame,
    )


def _turned(vector: Vector, frame: SightFrame) -> tuple[float, float, float]:
    """Return a vector in the axes in which the frame measures angles; see `to_sight`."""
    north, east, down = np.asarray(vector).tolist()
    return (down, east, -north) if frame is SightFrame.DOWN else (north, east, down)
