"""A smooth curve through waypoints, speeds along it, and the pose of what moves on it."""

import itertools
import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from follower_control.common.small_matrix import length
from follower_sim.kinematics import Triple
from follower_vision.geometry.camera_model import Vector

Corners = Literal["winding", "rounded"]

_STEP_M = 0.2
_LONGEST_M = 100e3
_TURNS_BACK = 1e-6
"""Length of the sum of two unit chords from which on it says where the course leads."""

_KEPT = 16
"""So many poses are kept: one step asks for the same few again and again."""


def _catmull_rom(points: Vector, closed: bool) -> Vector:
    """Sample a centripetal Catmull-Rom spline (Yuksel et al. 2011) through (N, 3) points."""
    if closed:
        padded = np.vstack([points[-1:], points, points[:2]])
    else:
        padded = np.vstack([2 * points[:1] - points[1:2], points, 2 * points[-1:] - points[-2:-1]])
    pieces = [_spline_piece(padded[i : i + 4]) for i in range(len(padded) - 3)]
    return np.vstack([*pieces, padded[-2:-1]])


def _spline_piece(p: Vector) -> Vector:
    """Sample between the middle two of four points, the end left out."""
    knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1) ** 0.5)])
    count = max(2, math.ceil(length(p[2] - p[1]) / _STEP_M))
    t = np.linspace(knots[1], knots[2], count, endpoint=False)[:, None]

    def mix(a: Vector, b: Vector, ta: float, tb: float) -> Vector:
        return np.asarray(((tb - t) * a + (t - ta) * b) / (tb - ta))

    a1 = mix(p[0], p[1], knots[0], knots[1])
    a2 = mix(p[1], p[2], knots[1], knots[2])
    a3 = mix(p[2], p[3], knots[2], knots[3])
    b1 = mix(a1, a2, knots[0], knots[2])
    b2 = mix(a2, a3, knots[1], knots[3])
    return mix(b1, b2, knots[1], knots[2])


def _rounded(points: Vector, radius_m: float, closed: bool) -> Vector:
    """Sample straight lines whose corners are replaced by arcs (horizontally)."""
    count = len(points)
    corners = range(count) if closed else range(1, count - 1)
    parts = [_arc(points[i - 1], points[i], points[(i + 1) % count], radius_m) for i in corners]
    if closed:
        line = np.vstack([*parts, parts[0][:1]])
    else:
        line = np.vstack([points[:1], *parts, points[-1:]])
    return _densified(line)


def _arc(before: Vector, corner: Vector, after: Vector, radius_m: float) -> Vector:
    """Return the points of the arc that rounds `corner`; it never eats over half of a side."""
    inward, outward = before - corner, after - corner
    in_length, out_length = length(inward), length(outward)
    a, b = inward / in_length, outward / out_length
    half = math.acos(float(np.clip((a * b).sum(), -1, 1))) / 2
    if half > math.pi / 2 - 1e-3 or half < 1e-3:
        return corner[None, :]
    cut = min(radius_m / math.tan(half), in_length / 2, out_length / 2)
    radius = cut * math.tan(half)
    bisector = (a + b) / length(a + b)
    centre = corner + bisector * radius / math.sin(half)
    start = corner + a * cut - centre
    end = corner + b * cut - centre
    sweep = math.pi - 2 * half
    t = np.linspace(0, 1, max(3, math.ceil(radius * sweep / _STEP_M)))[:, None]
    return np.asarray(
        centre + (np.sin((1 - t) * sweep) * start + np.sin(t * sweep) * end) / math.sin(sweep)
    )


def _densified(line: Vector) -> Vector:
    """Put points between those of a polyline so that none are farther than a step apart."""
    pieces = []
    for a, b in itertools.pairwise(line):
        count = max(1, math.ceil(length(b - a) / _STEP_M))
        pieces.append(a + (b - a) * np.linspace(0, 1, count, endpoint=False)[:, None])
    return np.vstack([*pieces, line[-1:]])


class Course:
    """A curve in space, parametrised by the distance along it.

    Args:
        points: way points (north, east) or (north, east, height) in metres; at least two (three
            when closed), no two neighbours at one place.
        corners: "winding" goes through every point on a Catmull-Rom spline; "rounded" drives
            straight lines with arcs of `radius_m` at the corners.
        radius_m: of the arcs; smaller where a side is too short.
        closed: the course returns to its first point and goes on.

    Raises:
        ValueError: too few points, two neighbours at one place, too long, or a bad radius.
    """

    def __init__(
        self,
        points: Sequence[Sequence[float]],
        corners: Corners = "winding",
        radius_m: float = 5.0,
        closed: bool = False,
    ) -> None:
        way = np.array([[*p, 0.0][:3] for p in points], np.float64).reshape(-1, 3)
        _check(way, radius_m, closed)
        way[:, 2] *= -1
        line = (
            _catmull_rom(way, closed) if corners == "winding" else _rounded(way, radius_m, closed)
        )
        steps = np.diff(line, axis=0)
        self.closed = closed
        self.line = line
        self._lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
        self.length_m = float(self._lengths[-1])
        self._at: list[float] = self._lengths.tolist()
        self._places = _triples(line)
        self._directions = _triples(_directions(steps, closed))

    def position(self, distance_m: float) -> Vector:
        """Return (north, east, down); before the start and after the end: the end points."""
        return np.array(self.at(distance_m)[0])

    def direction(self, distance_m: float) -> Vector:
        """Return the unit tangent (north, east, down)."""
        return np.array(self.at(distance_m)[1])

    def at(self, distance_m: float) -> tuple[Triple, Triple]:
        """Return position, metres NED, and unit direction."""
        s = distance_m % self.length_m if self.closed else distance_m
        i = bisect_right(self._at, s) - 1
        if i < 0 or i >= len(self._at) - 1:
            place, (north, east, down) = self._places[max(i, 0)], self._directions[max(i, 0)]
        else:
            past, step = s - self._at[i], self._at[i + 1] - self._at[i]
            place = _between(self._places[i], self._places[i + 1], step, past)
            tangents = self._directions[i], self._directions[i + 1]
            north, east, down = _between(*tangents, step, past)
        length = math.sqrt(north**2 + east**2 + down**2)
        return place, (north / length, east / length, down / length)


def _between(a: Triple, b: Triple, step: float, past: float) -> Triple:
    """Return what lies so far `past` a on the way to b, a `step` away; plain floats are fastest."""
    return (
        (b[0] - a[0]) / step * past + a[0],
        (b[1] - a[1]) / step * past + a[1],
        (b[2] - a[2]) / step * past + a[2],
    )


def _triples(rows: Vector) -> list[Triple]:
    return [(north, east, down) for north, east, down in rows.tolist()]


def _check(way: Vector, radius_m: float, closed: bool) -> None:
    least = 3 if closed else 2
    if len(way) < least:
        raise ValueError(f"a course needs at least {least} points")
    around = np.vstack([way, way[:1]]) if closed else way
    legs_m = np.linalg.norm(np.diff(around, axis=0), axis=1)
    if legs_m.min() < 0.01:
        raise ValueError("two neighbouring points of a course are at one place")
    check_length(float(legs_m.sum()))
    if not radius_m > 0:
        raise ValueError("a course's radius must be positive")


def check_length(length_m: float) -> None:
    """Refuse a course that this computer's memory may not hold.

    Raises:
        ValueError: it is too long.
    """
    if length_m > _LONGEST_M:
        raise ValueError(f"a course is at most {_LONGEST_M / 1000:g} km long")


def _directions(steps: Vector, closed: bool) -> Vector:
    """Tangents at the samples: the mean of the chords before and after.

    Where the course turns straight back there is no mean: it turns on the spot, to the right.
    """
    units = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    before = np.vstack([units[-1:] if closed else units[:1], units])
    after = np.vstack([units, units[:1] if closed else units[-1:]])
    mean = before + after
    for i in np.flatnonzero(np.linalg.norm(mean, axis=1) < _TURNS_BACK):
        mean[i] = _to_its_right(before[i])
    return np.asarray(mean / np.linalg.norm(mean, axis=1, keepdims=True))


def _to_its_right(chord: Vector) -> Vector:
    """Return a level direction at right angles to a chord; north to one that stands upright."""
    north, east, _ = chord
    level = math.hypot(north, east)
    return np.array([-east, north, 0.0] if level > _TURNS_BACK else [1.0, 0.0, 0.0])


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
        """Return the distance covered since time 0, metres."""
        return self._at(time_s).distance(time_s) if time_s >= 0 else 0.0


@dataclass(frozen=True, slots=True)
class TargetPose:
    """A target's reference point (where it touches the ground) at one time.

    Attributes:
        position_m: (north, east, down).
        velocity_m_s: (north, east, down).
        heading_rad: from north, clockwise seen from above.
        distance_m: how far it has travelled; moves legs and rotors.
    """

    position_m: Triple
    velocity_m_s: Triple
    heading_rad: float
    distance_m: float


class TargetPath:
    """A course and a speed profile: pose in closed form at any time.

    Attributes:
        course: where it leads.
        pose: returns the pose at a time of the scenario, seconds; kept for the newest times.
    """

    def __init__(self, course: Course, speeds: SpeedProfile) -> None:
        self.course = course
        self._speeds = speeds
        self.pose = lru_cache(_KEPT)(self._pose)

    def _pose(self, time_s: float) -> TargetPose:
        """Return the pose; at the end of an open course the target stands."""
        distance = self._speeds.distance_m(time_s)
        speed = self._speeds.speed_m_s(time_s)
        if not self.course.closed and distance >= self.course.length_m:
            speed = 0.0
        place, tangent = self.course.at(distance)
        north, east, down = tangent
        heading = math.atan2(east, north)
        return TargetPose(place, (north * speed, east * speed, down * speed), heading, distance)

    def shortfall_m(self, until_s: float) -> float:
        """Return by how much the speeds drive past the course's end until `until_s`."""
        if self.course.closed:
            return 0.0
        return max(0.0, self._speeds.distance_m(until_s) - self.course.length_m)
