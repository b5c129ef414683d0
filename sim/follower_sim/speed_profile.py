"""How fast a target moves along its course: speeds with smooth changes between them."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True, slots=True)
class SpeedChange:
    """A change to another speed.

    Attributes:
        at_s: when the change begins.
        speed_m_s: the speed it ends at; not negative.
        acceleration_m_s2: the largest acceleration or deceleration during the change.

    Raises:
        ValueError: a time or speed is negative, or the acceleration is not positive.
    """

    at_s: float
    speed_m_s: float
    acceleration_m_s2: float = 2.0

    __pydantic_config__: ClassVar = {"extra": "forbid"}

    def __post_init__(self) -> None:
        if self.at_s < 0 or self.speed_m_s < 0 or not self.acceleration_m_s2 > 0:
            raise ValueError(
                "a speed change needs a time and a speed from 0 up and a positive acceleration"
            )


@dataclass(frozen=True, slots=True)
class _Ramp:
    """From `start_s` on: speed `before` turns into `after` within `duration_s`."""

    start_s: float
    duration_s: float
    before: float
    after: float
    distance_m: float

    def speed(self, time_s: float) -> float:
        if time_s >= self.start_s + self.duration_s:
            return self.after
        x = (time_s - self.start_s) / self.duration_s
        return self.before + (self.after - self.before) * x * x * (3 - 2 * x)

    def distance(self, time_s: float) -> float:
        elapsed = time_s - self.start_s
        ramped = min(elapsed, self.duration_s)
        x = ramped / self.duration_s if self.duration_s > 0 else 0.0
        gained = (self.after - self.before) * self.duration_s * x**3 * (1 - x / 2)
        held = self.after * (elapsed - ramped)
        return self.distance_m + self.before * ramped + gained + held


class SpeedProfile:
    """Speed and distance over time in closed form.

    A change is a cubic (smoothstep) ramp, so that acceleration is continuous; it takes
    `1.5 * |difference| / acceleration` seconds, which puts the peak at the given acceleration.

    Args:
        changes: in the order of time. The speed is 0 before the first; a first change at 0 s is
            the initial speed, taken without a ramp.

    Raises:
        ValueError: the changes are out of order, or one begins before the last has ended.
    """

    def __init__(self, changes: Sequence[SpeedChange]) -> None:
        self._ramps = [_Ramp(0.0, 0.0, 0.0, 0.0, 0.0)]
        for change in changes:
            self._append(change)
        self._starts_s = [ramp.start_s for ramp in self._ramps]

    def _append(self, change: SpeedChange) -> None:
        last = self._ramps[-1]
        if change.at_s < last.start_s + last.duration_s:
            raise ValueError(
                f"the speed change at {change.at_s:g} s begins before the one at "
                f"{last.start_s:g} s has ended at {last.start_s + last.duration_s:g} s"
            )
        before = change.speed_m_s if change.at_s == 0 else last.after
        duration = 1.5 * abs(change.speed_m_s - before) / change.acceleration_m_s2
        distance = last.distance(change.at_s)
        self._ramps.append(_Ramp(change.at_s, duration, before, change.speed_m_s, distance))

    def _at(self, time_s: float) -> _Ramp:
        return self._ramps[bisect_right(self._starts_s, max(time_s, 0.0)) - 1]

    def speed_m_s(self, time_s: float) -> float:
        """Return the speed in m/s; before time 0 nothing moves."""
        return self._at(time_s).speed(time_s) if time_s >= 0 else 0.0

    def distance_m(self, time_s: float) -> float:
        """Return the distance covered since time 0."""
        return self._at(time_s).distance(time_s) if time_s >= 0 else 0.0
