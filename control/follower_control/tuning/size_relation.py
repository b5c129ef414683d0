"""How large a target looks from how far: size = metres / distance ^ slope (slope 1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from follower_control.tuning.fit import Interval
from follower_control.tuning.rational import Array
from follower_control.tuning.response_data import TooLittleError

_LEAST = 12
_SPREAD = 1.3
"""The largest distance over the smallest from which on a slope can be told."""
_SURE = 0.95


@dataclass(frozen=True, slots=True)
class SizeFit:
    """What the target measures.

    Attributes:
        size_m: the root of its width times its height, as seen, with slope 1.
        slope: how the angle falls with the distance; None where the distance hardly varied. Far
            from 1, the box does not keep to the target, or the distance is wrong.
        spread: of single sightings about the relation, as a share; in the held-out last third.
        samples: how many sightings were fitted.
    """

    size_m: Interval
    slope: Interval | None
    spread: float
    samples: int


def fit_size(angles_rad: Sequence[float], ranges_m: Sequence[float]) -> SizeFit:
    """Fit the relation to sightings in the order of time.

    Sightings far enough from each other are wanted: what neighbours share counts as news here.

    Raises:
        TooLittleError: there are too few, or some are not finite and above 0.
    """
    angles = np.asarray(angles_rad, np.float64)
    ranges = np.asarray(ranges_m, np.float64)
    if len(angles) < _LEAST:
        raise TooLittleError(
            f"only {len(angles)} sightings of a target on the ground; {_LEAST} are needed"
        )
    if not (np.all(np.isfinite(angles * ranges)) and min(angles.min(), ranges.min()) > 0):
        raise TooLittleError("sizes and distances are finite and above 0")
    logs = np.asarray(np.log(angles * ranges), np.float64)
    first = 2 * len(logs) // 3
    held_out = logs[first:] - logs[:first].mean()
    return SizeFit(
        _mean(logs),
        _slope(np.log(angles), np.log(ranges)),
        float(np.sqrt(np.mean(held_out**2))),
        len(logs),
    )


def _mean(logs: Array) -> Interval:
    width = float(stats.t.ppf(0.5 + _SURE / 2, len(logs) - 1) * stats.sem(logs))
    middle = float(logs.mean())
    return Interval(math.exp(middle), math.exp(middle - width), math.exp(middle + width))


def _slope(angles: Array, ranges: Array) -> Interval | None:
    if float(np.ptp(ranges)) < math.log(_SPREAD):
        return None
    line = stats.linregress(ranges, angles)
    width = float(stats.t.ppf(0.5 + _SURE / 2, len(ranges) - 2) * line.stderr)
    slope = -float(line.slope)
    return Interval(slope, slope - width, slope + width)
