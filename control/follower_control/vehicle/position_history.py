"""A short memory of how the vehicle moved, to look up where it was when a frame was taken."""

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass

import numpy as np

from follower_control.vehicle.state import LocalPosition
from follower_vision.geometry.camera_model import Vector

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
        return _between(self._points[number - 1], later, time_s)


def _time_s(point: _Point) -> float:
    return point.time_s


def _between(before: _Point, after: _Point | None, time_s: float) -> Vector | None:
    ahead_s, velocity = time_s - before.time_s, before.velocity_m_s
    if after is not None:
        velocity = (after.place_m - before.place_m) / (after.time_s - before.time_s)
    elif ahead_s > _AHEAD_S:
        return None
    return np.asarray(before.place_m + ahead_s * velocity)
