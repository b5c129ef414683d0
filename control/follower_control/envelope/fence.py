"""A polygon that the vehicle never leaves by itself."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

from follower_control.envelope.jerk_limiter import Limit, VelocityBound
from follower_control.vehicle.state import Origin

_TOUCHING_M = 1e-6
_BACK_RAD = math.radians(45)
"""Outside, the way back may be off the shortest one by this much."""
_TANGENTS = 12
"""At so many places of a circle: a way between two of them is longer by 3 % at most."""

Corners = Sequence[tuple[float, float]]


class Fence:
    """A simple polygon, convex or not, and what speeds it allows at a place.

    Horizontal vectors are complex numbers, north + 1j * east.

    Args:
        corners: (north, east) in metres, in either order of turning; the last one is joined to the
            first.

    Raises:
        ValueError: it is no polygon, or its sides cross each other.
    """

    def __init__(self, corners: Corners) -> None:
        check_corners(corners)
        points = [complex(north, east) for north, east in corners]
        if _area(points) < 0:
            points.reverse()
        self._sides = list(zip(points, [*points[1:], points[0]], strict=True))
        before = [points[-1], *points[:-1]]
        ways = zip(before, self._sides, strict=True)
        self._tips = [tip for a, (b, c) in ways if (tip := _Tip.of(a, b, c)) is not None]

    @classmethod
    def around(cls, home_deg: tuple[float, float], corners_deg: Corners) -> Fence:
        """Make a fence about home from (latitude, longitude) corners in degrees.

        Raises:
            ValueError: see the class.
        """
        home = Origin(*home_deg)
        return cls([home.local(*corner) for corner in corners_deg])

    def contains(self, place: complex) -> bool:
        """Whether a place lies inside, its sides not counted."""
        crossings = 0
        for a, b in self._sides:
            if (a.imag > place.imag) != (b.imag > place.imag):
                share = (place.imag - a.imag) / (b.imag - a.imag)
                crossings += place.real < a.real + share * (b.real - a.real)
        return crossings % 2 == 1 and self.distance_m(place) > _TOUCHING_M

    def distance_m(self, place: complex) -> float:
        """Return the distance to the nearest side, metres."""
        return min(abs(_nearest(side, place) - place) for side in self._sides)

    def outside_m(self, place: complex) -> float:
        """Return how far outside a place lies, metres; 0 inside."""
        return 0.0 if self.contains(place) else self.distance_m(place)

    def bounds(
        self, place: complex, margin_m: float, speed_at: Callable[[float], float]
    ) -> tuple[VelocityBound, ...]:
        """Return how fast the vehicle may move in which directions; in the world's axes.

        Inside, towards each side, and into a sharp corner, only so fast that it stops before it.
        Outside, only back.

        Args:
            place: where the vehicle is.
            margin_m: how far from the sides it stops.
            speed_at: the speed from which it stops within a distance.
        """
        if self.contains(place):
            ways = [_nearest(side, place) - place for side in self._sides]
            rooms = [(way / abs(way), abs(way) - margin_m) for way in ways]
            rooms += [(tip.way, tip.room_m(place, margin_m)) for tip in self._tips]
            return tuple(VelocityBound(way, speed_at(room_m), Limit.FENCE) for way, room_m in rooms)
        back = self._way_back(place)
        return tuple(
            VelocityBound(-back * cmath.rect(1.0, turn), 0.0, Limit.FENCE)
            for turn in (0.0, _BACK_RAD, -_BACK_RAD)
        )

    def _way_back(self, place: complex) -> complex:
        side = min(self._sides, key=lambda side: abs(_nearest(side, place) - place))
        way = _nearest(side, place) - place
        if abs(way) > _TOUCHING_M:
            return way / abs(way)
        along = side[1] - side[0]
        return along * 1j / abs(along)


@dataclass(frozen=True, slots=True)
class _Tip:
    """A sharp corner: its sides alone allow more than can be braked, for both are come near to.

    Attributes:
        corner: where it is.
        way: the unit vector that halves it, outwards.
        half_rad: half of its angle.
    """

    corner: complex
    way: complex
    half_rad: float

    @classmethod
    def of(cls, before: complex, corner: complex, after: complex) -> _Tip | None:
        """Return the corner between its neighbours; None if it is not sharper than 90 degrees."""
        back, ahead = ((end - corner) / abs(end - corner) for end in (before, after))
        turned = ahead.conjugate() * back  # from the side after it to the one before: inside
        if turned.imag <= 0 or turned.real <= 0:
            return None
        return cls(corner, -(back + ahead) / abs(back + ahead), cmath.phase(turned) / 2)

    def room_m(self, place: complex, margin_m: float) -> float:
        """Return how far it is to where a vehicle stops; infinite if not between the sides."""
        left = (self.corner - place) * self.way.conjugate()
        between = abs(left.imag) <= left.real * math.tan(self.half_rad)
        return left.real - margin_m / math.sin(self.half_rad) if between else math.inf


def circle_bounds(
    place: complex, radius_m: float, speed_at: Callable[[float], float]
) -> list[VelocityBound]:
    """Return how fast the vehicle may move in which directions within a circle around home.

    In each of several directions towards the tangent there. The nearest tangent alone would let
    the vehicle past the middle of a small circle faster than it can brake on the other side.
    Outside, not away from home: there the circle through its place counts.

    Args:
        place: where the vehicle is.
        radius_m: where it stops.
        speed_at: the speed from which it stops within a distance.
    """
    away_m, outward = cmath.polar(place)
    radius_m = max(radius_m, away_m)
    turns = [number * math.tau / _TANGENTS for number in range(_TANGENTS)]
    return [
        VelocityBound.towards(
            outward + turn, speed_at(radius_m - away_m * math.cos(turn)), Limit.FENCE
        )
        for turn in turns
    ]


def check_corners(corners: Corners) -> None:
    """Refuse what is no simple polygon.

    Raises:
        ValueError: see the message.
    """
    if len(corners) < 3:
        raise ValueError(f"a fence has at least three corners, not {len(corners)}")
    if not all(math.isfinite(number) for corner in corners for number in corner):
        raise ValueError("a fence's corners are finite numbers")
    points = [complex(*corner) for corner in corners]
    sides = list(zip(points, [*points[1:], points[0]], strict=True))
    if min(abs(b - a) for a, b in sides) == 0:
        raise ValueError("two neighbouring corners of the fence are the same")
    if any(_cross(one, other) for one, other in combinations(sides, 2)):
        raise ValueError("the fence's sides cross each other")
    if _area(points) == 0:
        raise ValueError("the fence encloses nothing")


def _nearest(side: tuple[complex, complex], place: complex) -> complex:
    """Return the point of a side that is nearest to a place."""
    start, end = side
    along = end - start
    share = ((place - start) * along.conjugate()).real / abs(along) ** 2
    return start + min(max(share, 0.0), 1.0) * along


def _area(points: Sequence[complex]) -> float:
    """Return the enclosed area, positive if the corners turn from north to east."""
    following = [*points[1:], points[0]]
    return sum((a.conjugate() * b).imag for a, b in zip(points, following, strict=True)) / 2


def _cross(one: tuple[complex, complex], other: tuple[complex, complex]) -> bool:
    """Whether two sides meet other than at a common corner."""
    if set(one) & set(other):
        return False
    if not _overlap([one[0].real, one[1].real], [other[0].real, other[1].real]):
        return False
    if not _overlap([one[0].imag, one[1].imag], [other[0].imag, other[1].imag]):
        return False
    return _parts(one, *other) and _parts(other, *one)


def _overlap(one: list[float], other: list[float]) -> bool:
    return max(min(one), min(other)) <= min(max(one), max(other))


def _parts(side: tuple[complex, complex], a: complex, b: complex) -> bool:
    """Whether two points lie on different sides of a line, or one of them on it."""
    along = (side[1] - side[0]).conjugate()
    return ((a - side[0]) * along).imag * ((b - side[0]) * along).imag <= 0
