"""A short memory of the vehicle's attitude and path: how it was when a frame was taken."""

import math
from bisect import bisect_right
from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from follower_control.vehicle.state import Attitude, LocalPosition
from follower_vision.geometry.camera_model import Vector
from follower_vision.geometry.line_of_sight import wrap_angle

_KEPT_ATTITUDES_S = 3.0
"""Longer than any camera's latency and vision's time together."""
_EXTRAPOLATE_S = 0.1
"""How far past the newest sample its body rates are trusted."""
_GAP_S = 0.5
"""Two samples further apart than this are not interpolated between."""


class AttitudeHistory:
    """The newest attitudes in order of time; used by one thread."""

    def __init__(self) -> None:
        self._samples: deque[Attitude] = deque()

    def __len__(self) -> int:
        """How many samples are kept now."""
        return len(self._samples)

    def add(self, sample: Attitude) -> bool:
        """Remember a sample; False if it is refused.

        Refused are samples that are not finite and those not newer than the newest one.
        """
        if not sample.is_finite:
            return False
        if self._samples and sample.time_s <= self._samples[-1].time_s:
            return False
        self._samples.append(sample)
        while sample.time_s - self._samples[0].time_s > _KEPT_ATTITUDES_S:
            self._samples.popleft()
        return True

    def clear(self) -> None:
        """Forget everything, as after the clock or the autopilot started anew."""
        self._samples.clear()

    def at(self, time_s: float) -> Attitude | None:
        """Return the attitude at `time_s`, None where it is not known.

        Between samples it is interpolated, angle by angle and the short way round; after the
        newest it is turned on by the body rates for at most 0.1 s.
        """
        if not self._samples or not math.isfinite(time_s):
            return None
        newest = self._samples[-1]
        if time_s >= newest.time_s:
            ahead = time_s - newest.time_s
            return turned_on(newest, ahead) if ahead <= _EXTRAPOLATE_S else None
        for later, earlier in pairwise(reversed(self._samples)):
            if earlier.time_s <= time_s:
                gap = later.time_s - earlier.time_s
                return _between(earlier, later, time_s) if gap <= _GAP_S else None
        return None


def turned_on(start: Attitude, interval_s: float) -> Attitude:
    """Return the attitude after `interval_s` at constant body rates (to first order).

    The body rates become Euler angle rates by the usual kinematic relation, which needs a pitch
    away from ±90 degrees; there the rates of roll and yaw are bounded.
    """
    sr, cr = math.sin(start.roll_rad), math.cos(start.roll_rad)
    level = max(math.cos(start.pitch_rad), 0.1)
    turn = (start.pitch_rate_rad_s * sr + start.yaw_rate_rad_s * cr) / level
    roll = start.roll_rate_rad_s + turn * math.sin(start.pitch_rad)
    pitch = start.pitch_rate_rad_s * cr - start.yaw_rate_rad_s * sr
    return Attitude(
        wrap_angle(start.roll_rad + roll * interval_s),
        start.pitch_rad + pitch * interval_s,
        wrap_angle(start.yaw_rad + turn * interval_s),
        start.roll_rate_rad_s,
        start.pitch_rate_rad_s,
        start.yaw_rate_rad_s,
        start.time_s + interval_s,
    )


def _between(a: Attitude, b: Attitude, time_s: float) -> Attitude:
    share = (time_s - a.time_s) / (b.time_s - a.time_s)

    def angle(start: float, end: float) -> float:
        return wrap_angle(start + share * wrap_angle(end - start))

    def rate(start: float, end: float) -> float:
        return start + share * (end - start)

    return Attitude(
        angle(a.roll_rad, b.roll_rad),
        angle(a.pitch_rad, b.pitch_rad),
        angle(a.yaw_rad, b.yaw_rad),
        rate(a.roll_rate_rad_s, b.roll_rate_rad_s),
        rate(a.pitch_rate_rad_s, b.pitch_rate_rad_s),
        rate(a.yaw_rate_rad_s, b.yaw_rate_rad_s),
        time_s,
    )


_KEPT_S = 6.0
_AHEAD_S = 0.5
"""So far past the newest telemetry its velocity is trusted; a longer gap is a new path."""


@dataclass(frozen=True, slots=True, eq=False)
class _Point:
    time_s: float
    place_m: Vector
    velocity_m_s: Vector


class PositionHistory:
    """The way that the vehicle went, added up from its velocities.

    Positions are not taken: they jump when the autopilot's own estimate is corrected, and the
    target would seem to jump with them. So the origin is anywhere, and only differences count.
    """

    def __init__(self) -> None:
        self._points: deque[_Point] = deque()

    def clear(self) -> None:
        """Forget everything."""
        self._points.clear()

    def add(self, position: LocalPosition) -> bool:
        """Take in what telemetry says, if it is newer; whether the path could be kept.

        After a gap the path is another one, with another origin.
        """
        velocity = np.array(position.numbers[3:])
        if not self._points:
            self._points.append(_Point(position.time_s, np.zeros(3), velocity))
            return False
        last = self._points[-1]
        elapsed_s = position.time_s - last.time_s
        if elapsed_s > _AHEAD_S:
            self.clear()
            return self.add(position)
        if elapsed_s > 0:
            place = last.place_m + elapsed_s * (last.velocity_m_s + velocity) / 2
            self._points.append(_Point(position.time_s, place, velocity))
            while position.time_s - self._points[0].time_s > _KEPT_S:
                self._points.popleft()
        return True

    def at(self, time_s: float) -> Vector | None:
        """Return where the vehicle was, (3,) north, east, down; None where that is not known.

        After the newest telemetry its velocity leads on.
        """
        number = bisect_right(self._points, time_s, key=_time_s)
        if number == 0:
            return None
        later = self._points[number] if number < len(self._points) else None
        return _place_between(self._points[number - 1], later, time_s)


def _time_s(point: _Point) -> float:
    return point.time_s


def _place_between(before: _Point, after: _Point | None, time_s: float) -> Vector | None:
    ahead_s, velocity = time_s - before.time_s, before.velocity_m_s
    if after is not None:
        velocity = (after.place_m - before.place_m) / (after.time_s - before.time_s)
    elif ahead_s > _AHEAD_S:
        return None
    return np.asarray(before.place_m + ahead_s * velocity)
