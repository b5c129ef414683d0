"""What stands in the world: trees, houses, bridges, rocks; occluders and landmarks."""

from __future__ import annotations

from typing import Literal

import numpy as np

from follower_sim.mesh import Colour, Mesh
from follower_sim.shapes import Outline, Point, ball, box, convex, panel, prism, ring

SceneryKind = Literal[
    "broadleaf", "fir", "house", "bridge", "rock", "bale", "buoy", "canopy", "hall"
]

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


def scenery_mesh(
    kind: SceneryKind, size_m: float, rng: np.random.Generator, height_m: float = 2.6
) -> Mesh:
    """Return a body of the given kind; its looks vary with `rng`.

    `height_m` is that of the space below a canopy or in a hall.
    """
    if kind == "hall":
        return _hall(size_m, height_m)
    if kind == "canopy":
        return _canopy(size_m, height_m, rng)
    if kind == "broadleaf":
        return _broadleaf(size_m, rng)
    if kind == "fir":
        return _fir(size_m, rng)
    if kind == "house":
        return _house(size_m, rng)
    if kind == "bridge":
        return _bridge(size_m)
    if kind == "rock":
        return _rock(size_m, rng)
    return _bale(size_m) if kind == "bale" else _buoy(size_m)


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


def _hall(length: float, height: float) -> Mesh:
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
    tip: Point = (0.0, 0.0, height)
    base = list(ring(6, 0.22 * height, 0.3 * height))
    cone = [([base[i], base[(i + 1) % 6], tip], (60, 180, 60)) for i in range(6)]
    return Mesh.joined([float_, convex(cone, 1, (0, 0, 0.3 * height))])
