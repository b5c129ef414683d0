"""A smooth curve through way points, measured by its length."""

from __future__ import annotations

import bisect
import itertools
import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from follower_sim.kinematics import Triple
from follower_vision.camera import Vector

Corners = Literal["winding", "rounded"]

_STEP_M = 0.2


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
    count = max(2, math.ceil(float(np.linalg.norm(p[2] - p[1])) / _STEP_M))
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
    in_length, out_length = float(np.linalg.norm(inward)), float(np.linalg.norm(outward))
    a, b = inward / in_length, outward / out_length
    half = math.acos(float(np.clip(a @ b, -1, 1))) / 2
    if half > math.pi / 2 - 1e-3 or half < 1e-3:
        return corner[None, :]
    cut = min(radius_m / math.tan(half), in_length / 2, out_length / 2)
    radius = cut * math.tan(half)
    bisector = (a + b) / np.linalg.norm(a + b)
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
        count = max(1, math.ceil(float(np.linalg.norm(b - a)) / _STEP_M))
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
        ValueError: too few points, two neighbours at one place, or a bad radius.
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

    def _along(self, distance_m: float) -> float:
        return distance_m % self.length_m if self.closed else distance_m

    def position(self, distance_m: float) -> Vector:
        """Return (north, east, down); before the start and after the end: the end points."""
        return np.array(self.at(distance_m)[0])

    def direction(self, distance_m: float) -> Vector:
        """Return the unit tangent (north, east, down)."""
        return np.array(self.at(distance_m)[1])

    def at(self, distance_m: float) -> tuple[Triple, Triple]:
        """Return position and direction."""
        s = self._along(distance_m)
        i = bisect.bisect_right(self._at, s) - 1
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
    if np.linalg.norm(np.diff(around, axis=0), axis=1).min() < 0.01:
        raise ValueError("two neighbouring points of a course are at one place")
    if not radius_m > 0:
        raise ValueError("a course's radius must be positive")


def _directions(steps: Vector, closed: bool) -> Vector:
    """Tangents at the samples: the mean of the chords before and after."""
    units = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    before = np.vstack([units[-1:] if closed else units[:1], units])
    after = np.vstack([units, units[:1] if closed else units[-1:]])
    mean = before + after
    return np.asarray(mean / np.linalg.norm(mean, axis=1, keepdims=True))
