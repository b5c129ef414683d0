"""Random scenes of the simulator: a world whose moving bodies change from picture to picture."""

from __future__ import annotations

import colorsys
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import get_args

import numpy as np

from follower_sim.kinematics import Triple
from follower_sim.mesh import Colour, Mesh
from follower_sim.scenario import Scenario
from follower_sim.shapes import ball, box, prism, ring
from follower_sim.solid import Solid
from follower_sim.targets import TargetKind, target_mesh
from follower_sim.world import World
from follower_vision.lineofsight import rotation

KINDS: tuple[TargetKind, ...] = get_args(TargetKind)
"""What is to be found, by class number."""

REACH_M = 26.0
_GROUNDS = ("meadow", "farmland", "desert", "water")
_CLUTTER = ("broadleaf", "fir", "house", "rock", "bale", "buoy")
_LAND_SHARES = {"person": 0.2, "car": 0.6, "boat": 0.02, "quadrotor": 0.18}
_WATER_SHARES = {"person": 0.04, "car": 0.04, "boat": 0.68, "quadrotor": 0.24}
_HIGHEST_M = 18.0
_LONGEST_TRIES = 20
_BESIDE_RADII = 1.5
_ROOM = 0.65
_PAINTS = 14
_STRIDE_STEPS = 12


@dataclass(frozen=True, slots=True)
class Actor:
    """A body on the stage.

    Attributes:
        solid: as it stands in the world.
        kind: its class number; None for what is not to be found.
    """

    solid: Solid
    kind: int | None


class StagedWorld(World):
    """A world whose moving bodies are those put on the stage, whatever its paths say."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        super().__init__(scenario, seed)
        self.stage: Sequence[Actor] = ()
        rng = self._rng(20)
        self.paints = [random_colour(rng) for _ in range(_PAINTS)]

    def moving(self, time_s: float) -> list[Solid]:  # noqa: ARG002  the stage stands still
        """Return the bodies on the stage."""
        return [actor.solid for actor in self.stage]


def random_world(rng: np.random.Generator) -> StagedWorld:
    """Return a world with another ground, sky, light and scenery each time."""
    ground = _GROUNDS[int(rng.choice(4, p=(0.3, 0.36, 0.12, 0.22)))]
    scenario = Scenario.model_validate(
        {
            "name": "training",
            "title": "A scene to learn from.",
            "duration_s": 1,
            "ground": {"kind": ground, "roads": [] if ground == "water" else _roads(rng)},
            "sky": {
                "sun_azimuth_deg": float(rng.uniform(0, 360)),
                "sun_elevation_deg": float(rng.uniform(12, 80)),
                "clouds": float(rng.uniform(0, 1)),
                "visibility_m": float(rng.uniform(250, 1500)),
            },
            "targets": [
                {"kind": "car", "colour": "#808080", "path": {"points": [[-14, 0], [14, 0]]}}
            ],
            "scatter": _scatter(ground, rng),
            "start": {"at": [0, 0]},
            "select": {"colour": "#808080"},
        }
    )
    return StagedWorld(scenario, int(rng.integers(1 << 31)))


def _roads(rng: np.random.Generator) -> list[dict[str, object]]:
    roads: list[dict[str, object]] = []
    for _ in range(int(rng.integers(0, 3))):
        turn, off = rng.uniform(0, math.pi), rng.uniform(-15, 15)
        along = np.array([math.cos(turn), math.sin(turn)])
        middle = off * np.array([-along[1], along[0]])
        bend = middle + rng.uniform(-6, 6, 2)
        points = [(middle - 60 * along).tolist(), bend.tolist(), (middle + 60 * along).tolist()]
        surface = "asphalt" if rng.random() < 0.7 else "dirt"
        width = float(rng.uniform(4, 9))
        roads.append({"points": points, "width_m": width, "surface": surface})
    return roads


def _scatter(ground: str, rng: np.random.Generator) -> list[dict[str, object]]:
    kinds = ("rock", "buoy") if ground == "water" else _CLUTTER
    chosen = [kind for kind in kinds if rng.random() < 0.6]
    most = {"house": 5, "broadleaf": 16, "fir": 16}
    return [
        {
            "kind": kind,
            "count": int(rng.integers(1, most.get(kind, 9) + 1)),
            "clear_m": 5.0 if kind == "house" else 2.0,
            "within_m": 32,
        }
        for kind in chosen
    ]


def random_stage(world: StagedWorld, rng: np.random.Generator) -> list[Actor]:
    """Return bodies at random places, clear of each other and of what stands."""
    shares = _WATER_SHARES if world.scenario.ground.kind == "water" else _LAND_SHARES
    weights = [shares[kind] for kind in KINDS]
    kind, paint = int(rng.choice(len(KINDS), p=weights)), _paint(world, rng)
    actors = [_placed(world, [], kind, paint, rng)]
    while rng.random() < 0.66 and len(actors) < 7:
        # Things of one kind keep company, and some are painted alike: look-alikes.
        again = rng.random() < 0.6
        kind = kind if again else int(rng.choice(len(KINDS), p=weights))
        paint = paint if again and rng.random() < 0.5 else _paint(world, rng)
        actors.append(_placed(world, actors, kind, paint, rng))
    for _ in range(int(rng.integers(0, 5))):
        actors.append(_placed(world, actors, None, paint, rng))
    return actors


def _paint(world: StagedWorld, rng: np.random.Generator) -> Colour:
    return world.paints[int(rng.integers(_PAINTS))]


def _placed(
    world: StagedWorld,
    others: Sequence[Actor],
    kind: int | None,
    paint: Colour,
    rng: np.random.Generator,
) -> Actor:
    """Return a body at a free place; half of them near one that is there already, or beside it."""
    mesh = _clutter(rng) if kind is None else _body(KINDS[kind], paint, rng)
    flying = kind is not None and KINDS[kind] == "quadrotor" and rng.random() < 0.8
    height = float(rng.uniform(0.5, _HIGHEST_M)) if flying else 0.0
    roll, pitch = rng.normal(0, 0.12, 2).tolist() if flying else (0.0, 0.0)
    turn = rotation(roll, pitch, float(rng.uniform(-math.pi, math.pi)))
    near = others[int(rng.integers(len(others)))].solid if others else None
    solid = Solid.placed(mesh, (0.0, 0.0, 0.0), turn, world.sun)
    for _ in range(_LONGEST_TRIES):
        at = rng.uniform(-REACH_M, REACH_M, 2)
        if near is not None and rng.random() < 0.5:
            spread_m = 5.0 if rng.random() < 0.5 else _BESIDE_RADII * near.radius_m
            at = near.centre[:2] + rng.normal(0, spread_m, 2)
        place: Triple = (float(at[0]), float(at[1]), -height)
        solid = Solid.placed(mesh, place, turn, world.sun)
        if not any(_touch(solid, other) for other in (*world.scenery, *_solids(others))):
            break
    return Actor(solid, kind)


def _solids(actors: Sequence[Actor]) -> list[Solid]:
    return [actor.solid for actor in actors]


def _touch(solid: Solid, other: Solid) -> bool:
    room = _ROOM * (solid.radius_m + other.radius_m)
    return float(np.linalg.norm(solid.centre - other.centre)) < room


def _body(kind: TargetKind, colour: Colour, rng: np.random.Generator) -> Mesh:
    """Return a body in one of the world's paints; making one takes longer than drawing it."""
    walks = kind == "person" and rng.random() < 0.8
    travelled = 1.5 * int(rng.integers(_STRIDE_STEPS)) / _STRIDE_STEPS if walks else 0.0
    return _made(kind, colour, travelled)


_made = lru_cache(maxsize=600)(target_mesh)


def random_colour(rng: np.random.Generator) -> Colour:
    """Return a paint: any hue, or a grey as many cars have."""
    saturation = rng.uniform(0.35, 1.0) if rng.random() < 0.65 else rng.uniform(0, 0.15)
    light = rng.uniform(0.12, 0.95)
    red, green, blue = colorsys.hsv_to_rgb(rng.random(), saturation, light)
    return round(255 * blue), round(255 * green), round(255 * red)


def _clutter(rng: np.random.Generator) -> Mesh:
    """Return a thing of some paint that is of no class: a crate, a container, a drum, a ball."""
    colour, top, shape = random_colour(rng), random_colour(rng), int(rng.integers(4))
    if shape == 0:
        length, width, height = rng.uniform((0.3, 0.3, 0.2), (1.5, 1.5, 1.8))
        return box((length, width, height), colour, top=top)
    if shape == 1:
        length, width, height = rng.uniform((3, 1.8, 1.8), (7, 2.6, 2.8))
        return box((length, width, height), colour, top=top if rng.random() < 0.5 else None)
    radius, height = rng.uniform((0.1, 0.4), (0.9, 2.2))
    if shape == 2:
        return prism(ring(8, radius, 0), ring(8, radius, height), colour, top)
    return ball(radius, (0, 0, radius), colour)
