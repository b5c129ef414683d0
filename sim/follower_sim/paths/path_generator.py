"""Courses and speeds by a name and a few numbers, drawn from a seed."""

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from follower_control.common.strict_config import check_positive, check_ranges
from follower_sim.paths.spline import SpeedChange, check_length

ShapeKind = Literal["straight", "winding", "stop-and-go", "figure-eight", "evasive"]

Place = tuple[float, float]
"""(north, east) in metres."""

_SPARE_S = 10.0
_LATERAL_SHARE = 1.1
"""Sideways acceleration in an evasive turn, as a share of that along the course."""
_SHARPEST_RAD = math.radians(95)
_FASTEST = 1.2
_EIGHT_POINTS = 24


@dataclass(frozen=True, slots=True)
class PathShape:
    """A way of moving; it is drawn anew for each seed.

    Attributes:
        kind: "straight"; "winding": bends to both sides; "stop-and-go": gentle bends, with stops;
            "figure-eight": again and again; "evasive": sharp turns and changes of speed.
        speed_m_s: the usual speed.
        from_s: when the target sets off.
        scale_m: length of a bend, half the length of the eight.
        height_m: above the ground, for what flies.
        heading_deg: in which direction it sets off, clockwise from north.
        start: (north, east) where it stands at first.
        acceleration_m_s2: largest along the course.
    """

    kind: ShapeKind
    speed_m_s: float
    from_s: float = 14.0
    scale_m: float = 30.0
    height_m: float = 0.0
    heading_deg: float = 0.0
    start: Place = (0.0, 0.0)
    acceleration_m_s2: float = 1.5

    def __post_init__(self) -> None:
        check_positive(self, "speed_m_s", "acceleration_m_s2")
        check_ranges(self, from_s=(0, 1e9), height_m=(0, 1e9), scale_m=(1, 1e5))


def drawn(shape: PathShape, rng: np.random.Generator, until_s: float) -> dict[str, Any]:
    """Return a shape as the waypoints and speeds of a scenario's path, enough until a time.

    The keys are those of `PathSettings`; points are (north, east, height) in metres.
    """
    driven_s = max(0.0, until_s - shape.from_s) + _SPARE_S
    length_m = _FASTEST * shape.speed_m_s * driven_s + 2 * shape.scale_m
    if shape.kind != "figure-eight":
        check_length(length_m)
    places = _PLACES[shape.kind](shape, rng, length_m)
    return {
        "points": _placed(places, shape),
        "corners": "rounded" if shape.kind == "evasive" else "winding",
        "radius_m": _turn_radius_m(shape),
        "closed": shape.kind == "figure-eight",
        "speeds": _SPEEDS.get(shape.kind, _steady)(shape, rng, until_s),
    }


def _placed(places: list[Place], shape: PathShape) -> list[list[float]]:
    """Turn places that set off northwards at the origin to where the shape is."""
    turn = math.radians(shape.heading_deg)
    c, s = math.cos(turn), math.sin(turn)
    north, east = shape.start
    return [[north + c * n - s * e, east + s * n + c * e, shape.height_m] for n, e in places]


def _straight(_: PathShape, __: np.random.Generator, length_m: float) -> list[Place]:
    return [(0.0, 0.0), (length_m, 0.0)]


def _bends(shape: PathShape, rng: np.random.Generator, length_m: float) -> list[Place]:
    """Lean to one side and the other of the first direction, so that it leads somewhere."""
    degrees = (15.0, 35.0) if shape.kind == "winding" else (5.0, 15.0)
    sides = int(rng.choice([-1, 1])) * (-1) ** np.arange(math.ceil(length_m / shape.scale_m) + 1)
    headings = np.radians(rng.uniform(*degrees, len(sides))) * sides
    legs = [(shape.scale_m, float(heading)) for heading in headings]
    return _walked([(shape.scale_m / 2, 0.0), *legs])


def _evasive(shape: PathShape, rng: np.random.Generator, length_m: float) -> list[Place]:
    """Turn sharply, at random, never back into the way one came."""
    cut_m = _turn_radius_m(shape) * math.tan(_SHARPEST_RAD / 2)
    legs, heading, walked_m = [(shape.scale_m / 2 + cut_m, 0.0)], 0.0, 0.0
    while walked_m < length_m:
        turn = float(rng.uniform(0.5, 1.0)) * _SHARPEST_RAD * int(rng.choice([-1, 1]))
        # Towards the first direction again, or the target would run in circles.
        heading += -turn if abs(heading + turn) > math.radians(120) else turn
        leg_m = 2 * cut_m + float(rng.uniform(0.0, 0.5)) * shape.scale_m
        legs.append((leg_m, heading))
        walked_m += leg_m - cut_m
    return _walked(legs)


def _walked(legs: list[tuple[float, float]]) -> list[Place]:
    """Return the places that one comes to by (length, heading) from the origin."""
    places = [(0.0, 0.0)]
    for length, heading in legs:
        north, east = places[-1]
        places.append((north + length * math.cos(heading), east + length * math.sin(heading)))
    return places


def _eight(shape: PathShape, _: np.random.Generator, __: float) -> list[Place]:
    """Return points of Gerono's lemniscate, which sets off from its crossing."""
    t = 2 * math.pi * np.arange(_EIGHT_POINTS) / _EIGHT_POINTS
    along, across = shape.scale_m * np.sin(t), shape.scale_m * np.sin(t) * np.cos(t)
    half = math.sqrt(0.5)
    return [
        (half * (float(a) + float(b)), half * (float(b) - float(a)))
        for a, b in zip(along, across, strict=True)
    ]


def _turn_radius_m(shape: PathShape) -> float:
    sideways = _LATERAL_SHARE * shape.acceleration_m_s2
    return max(1.0, (_FASTEST * shape.speed_m_s) ** 2 / sideways)


def _steady(shape: PathShape, _: np.random.Generator, __: float) -> list[SpeedChange]:
    return [SpeedChange(shape.from_s, shape.speed_m_s, shape.acceleration_m_s2)]


def _stops(shape: PathShape, rng: np.random.Generator, until_s: float) -> list[SpeedChange]:
    goes: list[tuple[float, float]] = []
    now_s = shape.from_s
    while now_s < until_s:
        goes.append(
            (float(rng.uniform(6, 11)), shape.speed_m_s * float(rng.uniform(0.7, _FASTEST)))
        )
        goes.append((float(rng.uniform(2, 6)), 0.0))
        now_s += goes[-2][0] + goes[-1][0]
    return _timed(shape, goes)


def _changes(shape: PathShape, rng: np.random.Generator, until_s: float) -> list[SpeedChange]:
    count = math.ceil((until_s - shape.from_s) / 2) if until_s > shape.from_s else 1
    speeds = shape.speed_m_s * rng.uniform(0.4, _FASTEST, count)
    holds = rng.uniform(1.5, 4.0, count)
    return _timed(shape, list(zip(holds.tolist(), speeds.tolist(), strict=True)))


def _timed(shape: PathShape, goes: list[tuple[float, float]]) -> list[SpeedChange]:
    """Turn (seconds to hold, speed) into changes, each with the time that it takes."""
    changes, now_s, before = [], shape.from_s, 0.0
    for hold_s, speed in goes:
        changes.append(SpeedChange(now_s, speed, shape.acceleration_m_s2))
        now_s += 1.5 * abs(speed - before) / shape.acceleration_m_s2 + hold_s
        before = speed
    return changes


_PLACES = {
    "straight": _straight,
    "winding": _bends,
    "stop-and-go": _bends,
    "figure-eight": _eight,
    "evasive": _evasive,
}
_SPEEDS = {"stop-and-go": _stops, "evasive": _changes}
