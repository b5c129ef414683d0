"""What stands in the world: bodies of trees, houses, bridges and roofs, and where they are put."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from follower_control.common.small_matrix import length
from follower_sim.bodies.mesh import (
    Colour,
    Mesh,
    Outline,
    Point,
    ball,
    box,
    convex,
    panel,
    prism,
    ring,
)
from follower_sim.bodies.targets import HEIGHTS_M
from follower_sim.kinematics import Triple
from follower_sim.paths.spline import TargetPath
from follower_sim.scenario.scenario import (
    OcclusionSettings,
    ScatterSettings,
    Scenario,
    SceneryItem,
    SceneryKind,
    TargetSettings,
)
from follower_vision.geometry.camera_model import Vector

SIZES_M: dict[SceneryKind, tuple[float, float]] = {
    "broadleaf": (4.0, 7.0),
    "fir": (4.5, 8.5),
    "house": (8.0, 12.0),
    "bridge": (8.0, 8.0),
    "rock": (0.5, 1.6),
    "bale": (1.3, 1.6),
    "buoy": (1.0, 1.4),
    "canopy": (3.0, 3.0),
    "hall": (3.0, 3.0),
}
"""Usual smallest and largest size of each kind."""

DISTANT_KINDS: frozenset[SceneryKind] = frozenset({"broadleaf", "fir"})
"""The kinds that have a simpler body for the distance."""

_TRUNK: Colour = (52, 72, 92)
_LEAVES: list[Colour] = [(52, 122, 84), (48, 112, 70), (60, 136, 104), (58, 128, 122)]
_NEEDLES: list[Colour] = [(62, 96, 48), (56, 88, 40), (70, 104, 58)]
_WALLS: list[Colour] = [(206, 222, 228), (188, 206, 222), (178, 196, 206), (210, 214, 210)]
_ROOFS: list[Colour] = [(74, 82, 112), (66, 70, 84), (80, 92, 128)]
CANOPY_THICK_M = 0.3
"""How thick the roof of a canopy or a hall is."""

_CANOPY_WIDTH_M, _LONGEST_POST_M = 9.0, 3.0
_CONCRETE: Colour = (172, 176, 178)

_PIECE_M = 3.0
_OVERLAP = 0.75
_LEAST_M = 0.5
_CLEAR_M = 9.0
_STEP_S = 0.05
_LONGEST_WAIT_S, _WAIT_S, _APART_S = 14.0, 0.25, 5.0
_NEAR_S, _FAST = 0.5, 0.4
_TRIES_PER_ITEM = 40


def scenery_mesh(
    kind: SceneryKind, size_m: float, rng: np.random.Generator, height_m: float = 2.6
) -> Mesh:
    """Return a body of the given kind; its looks vary with `rng`.

    `height_m` is that of the space below a canopy or in a hall.
    """
    if kind in ("hall", "canopy"):
        return (_hall if kind == "hall" else _canopy)(size_m, height_m, rng)
    makers = {"broadleaf": _broadleaf, "fir": _fir, "house": _house, "rock": _rock}
    if kind in makers:
        return makers[kind](size_m, rng)
    return {"bridge": _bridge, "bale": _bale, "buoy": _buoy}[kind](size_m)


def distant_mesh(kind: SceneryKind, size_m: float, rng: np.random.Generator) -> Mesh:
    """Return the simpler body that stands for a tree in the distance.

    With a generator in the same state it has the colour of `scenery_mesh`.
    """
    if kind == "broadleaf":
        crown = _spindle(0.22 * size_m, 0.62 * size_m, size_m, 0.27 * size_m, _pick(_LEAVES, rng))
        trunk = _cone(0.0, 0.5 * size_m, 0.04 * size_m, _TRUNK, 0, sides=3)
        return Mesh.joined([trunk, crown])
    return _cone(0.1 * size_m, size_m, 0.22 * size_m, _pick(_NEEDLES, rng), 0, sides=5)


def _spindle(low: float, middle: float, high: float, radius: float, colour: Colour) -> Mesh:
    """Make a body of two pyramids, base to base."""
    belt = list(ring(5, radius, middle))
    ends: list[Point] = [(0.0, 0.0, low), (0.0, 0.0, high)]
    faces = [([belt[i], belt[(i + 1) % 5], end], colour) for i in range(5) for end in ends]
    return convex(faces, 1, (0, 0, middle))


def _pick(colours: list[Colour], rng: np.random.Generator) -> Colour:
    b, g, r = colours[int(rng.integers(len(colours)))]
    share = float(rng.uniform(0.9, 1.1))
    return round(b * share), round(g * share), round(r * share)


def _broadleaf(height: float, rng: np.random.Generator) -> Mesh:
    colour, radius = _pick(_LEAVES, rng), height * 0.27
    trunk = prism(ring(5, 0.035 * height, 0), ring(5, 0.025 * height, height * 0.5), _TRUNK)
    crowns = []
    for up, share in ((0.5, 0.95), (0.74, 0.8)):
        f, r = rng.uniform(-0.25, 0.25, 2) * radius
        rough = rng.uniform(0.86, 1.12, 12)
        crowns.append(ball(radius * share, (float(f), float(r), up * height), colour, rough))
    return Mesh.joined([trunk, *crowns])


def _fir(height: float, rng: np.random.Generator) -> Mesh:
    colour = _pick(_NEEDLES, rng)
    trunk = prism(ring(5, 0.03 * height, 0), ring(5, 0.03 * height, height * 0.2), _TRUNK)
    tiers = [(0.12, 0.55, 0.24), (0.36, 0.78, 0.185), (0.6, 1.0, 0.125)]
    cones = [
        _cone(low * height, high * height, r * height, colour, i + 1)
        for i, (low, high, r) in enumerate(tiers)
    ]
    return Mesh.joined([trunk, *cones])


def _cone(
    low: float, high: float, radius: float, colour: Colour, layer: int, sides: int = 8
) -> Mesh:
    base = list(ring(sides, radius, low))
    faces = [([base[i], base[(i + 1) % sides], (0.0, 0.0, high)], colour) for i in range(sides)]
    return convex(faces, layer, (0, 0, low))


def _house(length: float, rng: np.random.Generator) -> Mesh:
    width, wall, ridge = 0.7 * length, 0.32 * length, 0.55 * length
    walls, roof = _pick(_WALLS, rng), _pick(_ROOFS, rng)
    f, r = length / 2, width / 2
    body = box((length, width, wall), walls)
    gables = [([(s * f, r, wall), (s * f, -r, wall), (s * f, 0.0, ridge)], walls) for s in (1, -1)]
    g, e, low = f * 1.06, r * 1.12, wall - 0.12 * (ridge - wall)
    slopes = [
        ([(g, s * e, low), (-g, s * e, low), (-g, 0.0, ridge), (g, 0.0, ridge)], roof)
        for s in (1, -1)
    ]
    top = convex([*gables, *slopes], 2, (0, 0, wall))
    return Mesh.joined([body, *_openings(f, r, wall), top])


def _openings(f: float, r: float, wall: float) -> list[Mesh]:
    glass, door, centre = (92, 80, 70), (52, 74, 110), (0.0, 0.0, wall / 2)
    long = [[(f, s * r, 0), (-f, s * r, 0), (-f, s * r, wall), (f, s * r, wall)] for s in (1, -1)]
    short = [[(s * f, r, 0), (s * f, -r, 0), (s * f, -r, wall), (s * f, r, wall)] for s in (1, -1)]
    windows = [
        panel(face, (u, u + 0.14), (0.4, 0.75), glass, centre, 1)
        for face in long
        for u in (0.1, 0.43, 0.76)
    ]
    doors = [panel(face, (0.42, 0.58), (0.0, 0.68), door, centre, 1) for face in short]
    return [*windows, *doors]


def _bridge(length: float) -> Mesh:
    """Make a bridge across a road that runs forward below it; `length` is along that road."""
    half, span, low = length / 2, 14.0, 4.6
    deck = box((length, 2 * span, 0.7), _CONCRETE, (0, 0, low), (120, 118, 116))
    rails = [
        box((0.25, 2 * span, 0.9), _CONCRETE, (s * half, 0, low + 0.7), layer=1) for s in (1, -1)
    ]
    piers = [box((length * 0.6, 0.9, low), _CONCRETE, (0, s * 5.5, 0)) for s in (1, -1)]
    return Mesh.joined([*piers, deck, *rails])


def _canopy(length: float, height: float, rng: np.random.Generator) -> Mesh:
    """Make a roof of leaves over a way that runs forward below it, on a pair of posts.

    High above the ground it hangs, for what flies: a body is as far away as its middle, and with
    long posts that would be farther than what the roof hides.
    """
    foot = max(0.0, height - _LONGEST_POST_M)
    roof = box((length, _CANOPY_WIDTH_M, CANOPY_THICK_M), _pick(_LEAVES, rng), (0, 0, height))
    side = _CANOPY_WIDTH_M / 2 - 0.2
    posts = [box((0.15, 0.15, height - foot), _TRUNK, (0, s * side, foot)) for s in (1, -1)]
    return Mesh.joined([*posts, roof])


def _hall(length: float, height: float, _: np.random.Generator) -> Mesh:
    """Make a slice of a building that a road runs through, open at both ends."""
    walls, roof, side = _WALLS[2], _ROOFS[0], _CANOPY_WIDTH_M / 2
    sides = [box((length, 0.3, height), walls, (0, s * (side - 0.3), 0)) for s in (1, -1)]
    slab = box((length, _CANOPY_WIDTH_M, CANOPY_THICK_M), roof, (0, 0, height), layer=1)
    return Mesh.joined([*sides, slab])


def _rock(height: float, rng: np.random.Generator) -> Mesh:
    stone = _pick([(138, 144, 148), (120, 128, 136)], rng)
    return ball(height * 0.75, (0, 0, height * 0.25), stone, rng.uniform(0.7, 1.15, 12))


def _bale(width: float) -> Mesh:
    straw: Colour = (112, 182, 208)
    ends: list[Outline] = [
        [(f, s * width * 0.42, width / 2 + u) for f, u, _ in ring(10, width / 2, 0)]
        for s in (1, -1)
    ]
    return prism(ends[0], ends[1], straw)


def _buoy(height: float) -> Mesh:
    float_ = prism(ring(8, 0.45 * height, 0), ring(8, 0.35 * height, 0.3 * height), (40, 200, 235))
    cone = _cone(0.3 * height, height, 0.22 * height, (60, 180, 60), 1, sides=6)
    return Mesh.joined([float_, cone])


def canopies(
    scenario: Scenario, followed: TargetSettings, path: TargetPath
) -> Iterator[SceneryItem]:
    """Yield the pieces of roof above what the target passes while it is to be hidden.

    None stands where the target waits at first, or it could not be pointed out.
    """
    settings, (north, east, _) = scenario.occlusions, path.pose(0.0).position_m
    if settings.hidden_s <= 0:
        return
    free_s = 0.0
    for number in range(settings.count):
        earliest_s = max(settings.first_s + number * settings.every_s, free_s)
        from_s = _when(path, earliest_s, settings.hidden_s)
        free_s = from_s + settings.hidden_s + _APART_S
        if settings.distance_m is None:
            line = _above(path, from_s, settings.hidden_s)
        else:
            line = _between(path, from_s, followed, settings, settings.distance_m)
        heading = path.pose(from_s).heading_rad
        for place, heading_rad, length_m in _pieces(line, heading):
            if math.dist(place[:2], (north, east)) > _CLEAR_M:
                yield _roof(place, heading_rad, length_m, followed, settings)


def _when(path: TargetPath, from_s: float, hidden_s: float) -> float:
    """Return the first time from then on at which it may be hidden for so long, and no longer.

    A target that stops at the edge of a roof is hidden for as long as it stands there.
    """
    waits = np.arange(0.0, _LONGEST_WAIT_S, _WAIT_S).tolist()
    fast = _FAST * max(_slowest(path, from_s + wait_s) for wait_s in waits)
    for start_s in (from_s + wait_s for wait_s in waits):
        if min(_slowest(path, start_s), _slowest(path, start_s + hidden_s)) >= fast:
            return float(start_s)
    return from_s


def _slowest(path: TargetPath, time_s: float) -> float:
    """Return the least speed thereabouts."""
    return min(
        math.hypot(*path.pose(time_s + near_s).velocity_m_s) for near_s in (-_NEAR_S, 0.0, _NEAR_S)
    )


def _above(path: TargetPath, from_s: float, hidden_s: float) -> Vector:
    """Return the way of the target while it is to be hidden, (N, 3) north, east, down."""
    first_m = path.pose(from_s).distance_m
    length_m = max(_LEAST_M, path.pose(from_s + hidden_s).distance_m - first_m)
    along_m = np.linspace(first_m, first_m + length_m, math.ceil(length_m / 0.1) + 1)
    return np.array([path.course.position(float(along)) for along in along_m])


def _between(
    path: TargetPath,
    from_s: float,
    followed: TargetSettings,
    settings: OcclusionSettings,
    distance_m: float,
) -> Vector:
    """Return where the lines of sight to the hidden target cross the roof, (N, 3).

    The vehicle that sees it has followed it up to then, and stands from then on: for one that
    goes on it is hidden for a shorter time. The near edge hides by its lower side, and the far one
    by its upper side.
    """
    down = math.radians(settings.down_deg)
    north, east, _ = follower_place(path, from_s, distance_m * math.cos(down))
    high_m, half_m = distance_m * math.sin(down), HEIGHTS_M[followed.kind] / 2
    times = np.arange(0.0, settings.hidden_s + _STEP_S, _STEP_S).clip(max=settings.hidden_s)
    places = np.array([path.pose(from_s + float(t)).position_m for t in times])
    above_m = half_m + settings.clearance_m + CANOPY_THICK_M * times / settings.hidden_s
    share = np.maximum(1 - above_m / high_m, 0.0)[:, None]
    eye = np.array([north, east])
    return np.column_stack([eye + share * (places[:, :2] - eye), places[:, 2]])


def follower_place(path: TargetPath, until_s: float, behind_m: float) -> Triple:
    """Return the place of a follower drawn after the target on a string: north, east, target down.

    A pursuer that flies along its nose moves like that: on a tractrix.
    """
    start = path.pose(0.0)
    east, north = math.sin(start.heading_rad), math.cos(start.heading_rad)
    place = complex(*start.position_m[:2]) - behind_m * complex(north, east)
    for time_s in np.arange(0.0, until_s + _STEP_S, _STEP_S).clip(max=until_s):
        target = complex(*path.pose(float(time_s)).position_m[:2])
        away = abs(target - place)
        if away > behind_m:
            place = target + (place - target) * behind_m / away
    return place.real, place.imag, path.pose(until_s).position_m[2]


def _pieces(line: Vector, heading_rad: float) -> Iterator[tuple[Triple, float, float]]:
    """Yield the middle of each piece along a line, its heading and its length.

    A line without a length gets a short piece in the direction that is given.
    """
    lengths = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(line[:, :2], axis=0), axis=1))]
    )
    length_m = max(_LEAST_M, float(lengths[-1]))
    count = max(1, math.ceil(length_m / (_PIECE_M * _OVERLAP)))
    step_m = length_m / count
    piece_m = step_m if count == 1 else step_m / _OVERLAP
    for number in range(count):
        ends = (number * step_m, (number + 0.5) * step_m, (number + 1) * step_m)
        first, middle, last = (_at(line, lengths, end) for end in ends)
        north, east = (float(x) for x in last[:2] - first[:2])
        stands = math.hypot(north, east) < _LEAST_M / 2
        turned = heading_rad if stands else math.atan2(east, north)
        yield (float(middle[0]), float(middle[1]), float(middle[2])), turned, piece_m


def _at(line: Vector, lengths: Vector, along_m: float) -> Vector:
    return np.array([np.interp(along_m, lengths, line[:, axis]) for axis in range(3)])


def _roof(
    place: Triple,
    heading_rad: float,
    length_m: float,
    followed: TargetSettings,
    settings: OcclusionSettings,
) -> SceneryItem:
    return SceneryItem(
        kind=settings.kind,
        at=place[:2],
        heading_deg=math.degrees(heading_rad),
        size_m=length_m,
        height_m=HEIGHTS_M[followed.kind] + settings.clearance_m - place[2],
    )


def scattered(
    settings: ScatterSettings,
    lines: Sequence[Vector],
    standing: Sequence[SceneryItem],
    rng: np.random.Generator,
) -> list[SceneryItem]:
    """Return items at random places near the lines, (N, 3), but clear of them and each other.

    Fewer items than asked for come back where there is no room.
    """
    points = np.vstack(lines)[:, :2]
    low, high = points.min(axis=0) - settings.within_m, points.max(axis=0) + settings.within_m
    sizes = settings.size_m or SIZES_M[settings.kind]
    places = [np.array(item.at) for item in standing]
    items: list[SceneryItem] = []
    for _ in range(settings.count * _TRIES_PER_ITEM):
        if len(items) == settings.count:
            break
        at, size = rng.uniform(low, high), float(rng.uniform(*sizes))
        nearest = float(np.linalg.norm(points - at, axis=1).min())
        if not settings.clear_m <= nearest <= settings.within_m:
            continue
        if any(length(place - at) < size * 0.8 for place in places):
            continue
        places.append(at)
        heading = float(rng.uniform(0, 360))
        place = (float(at[0]), float(at[1]))
        items.append(SceneryItem(kind=settings.kind, at=place, heading_deg=heading, size_m=size))
    return items
