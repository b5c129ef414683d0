"""Outputs blended from one law to the next, the fastest closing speed, slowing down.

Stick offsets.
"""

import math
from dataclasses import dataclass, replace

from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint

_LEVEL_RAD, _STEEPEST_RAD = math.radians(1), math.radians(60)
_BACK_PER_S = 0.5
"""How fast an elevation at which the target is too low is to shrink, per second."""


class OutputBlend:
    """Makes a new law begin where the old one ended.

    Args:
        time_s: time constant with which the difference fades.

    Attributes:
        time_s: the same; may be changed.
    """

    def __init__(self, time_s: float) -> None:
        self.time_s = time_s
        self._present: VelocitySetpoint | None = None
        self._step = HOLD

    def start(self, present: VelocitySetpoint | None = None) -> None:
        """Have the next setpoint begin at `present`, or wherever it is."""
        self._present = present
        self._step = HOLD

    def update(self, asked: VelocitySetpoint, interval_s: float) -> VelocitySetpoint:
        """Return the setpoint with what is left of the difference."""
        if self._present is not None:
            self._step = _sum(self._present, asked, -1.0)
            self._present = None
        elif self._step is HOLD:
            return asked
        else:
            share = math.exp(-interval_s / self.time_s)
            self._step = _sum(HOLD, self._step, share)
        return _sum(asked, self._step, 1.0)


def _sum(a: VelocitySetpoint, b: VelocitySetpoint, factor: float) -> VelocitySetpoint:
    numbers = (x + factor * y for x, y in zip(a.values, b.values, strict=True))
    return VelocitySetpoint(*numbers)


def fastest_closing_m_s(
    elevation_rad: float, error_rad: float, range_m: float, sink_m_s: float
) -> float:
    """Return how fast the level distance to a target may shrink, not negative.

    Its elevation stays as it is while sinking is the closing speed times the elevation's tangent.
    What a target that is seen too low needs of the sinking itself is not there for closing in. A
    target that is not below is closed in on at any speed.

    Args:
        elevation_rad: of the target, negative below.
        error_rad: by how much it is seen higher than wanted.
        range_m: distance to it.
        sink_m_s: how fast the vehicle may sink for it.
    """
    if elevation_rad > -_LEVEL_RAD:
        return math.inf
    needed_m_s = _BACK_PER_S * range_m * max(-error_rad, 0.0)
    left_m_s = max(sink_m_s - needed_m_s, 0.0)
    return left_m_s / math.tan(min(-elevation_rad, _STEEPEST_RAD))


def slowed(asked: VelocitySetpoint, unseen_s: float, coast_s: float) -> VelocitySetpoint:
    """Return a setpoint whose velocity falls smoothly to 0 over the second half of `coast_s`.

    The first half is for blinks: slowing down for each would make the pursuit fall back. The yaw
    rate stays, so that the target is looked for where it should be.

    Args:
        asked: what the servo wants of the predicted target.
        unseen_s: how long the target has not been seen.
        coast_s: how long that is borne.
    """
    x = min(max(2 * unseen_s / coast_s - 1, 0.0), 1.0)
    left = 1 - x * x * (3 - 2 * x)
    return replace(
        asked,
        forward_m_s=left * asked.forward_m_s,
        right_m_s=left * asked.right_m_s,
        down_m_s=left * asked.down_m_s,
    )


@dataclass(frozen=True, slots=True)
class StickOffset:
    """By how much the wanted place is shifted; the shift lasts for as long as it is given.

    Attributes:
        distance_m: added to the wanted distance; positive is farther away.
        elevation_rad: added to the wanted elevation of the target; positive brings the vehicle
            lower, so that it looks up more.
        azimuth_rad: how far right of the nose the target is kept; negative turns the nose to the
            right of it.
        side_m_s: velocity around the target, to the right as seen from the vehicle. While `side`
            keeps a bearing, this moves it, and it stays where it was moved to.
    """

    distance_m: float = 0.0
    elevation_rad: float = 0.0
    azimuth_rad: float = 0.0
    side_m_s: float = 0.0

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite."""
        return all(map(math.isfinite, self.values))

    @property
    def values(self) -> tuple[float, float, float, float]:
        """(distance, elevation, azimuth, side) in m, rad, rad and m/s."""
        return self.distance_m, self.elevation_rad, self.azimuth_rad, self.side_m_s


NO_OFFSET = StickOffset()
"""Everything as the settings say."""
