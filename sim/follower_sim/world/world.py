"""Everything that a scenario puts into the world, at any time."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property, lru_cache, partial

import numpy as np

from follower_control.common.small_matrix import product
from follower_sim.bodies.mesh import Colour, Mesh
from follower_sim.bodies.targets import HEIGHTS_M, TargetKind, target_mesh
from follower_sim.kinematics import Triple
from follower_sim.paths.path_generator import Place
from follower_sim.paths.spline import Course, SpeedChange, SpeedProfile, TargetPath, TargetPose
from follower_sim.scenario.scenario import (
    PathSettings,
    RoadSettings,
    Scenario,
    SceneryItem,
    TargetSettings,
)
from follower_sim.world.ground_pyramid import Ground
from follower_sim.world.painter import SolidBatch
from follower_sim.world.scenery import (
    DISTANT_KINDS,
    SIZES_M,
    canopies,
    distant_mesh,
    scattered,
    scenery_mesh,
)
from follower_sim.world.silhouettes import BoundingSphere
from follower_sim.world.sky import panorama
from follower_sim.world.solid import Solid
from follower_sim.world.terrain import PALETTES, Road, make_ground
from follower_sim.world.wind import Wind
from follower_vision.geometry.camera_model import Vector
from follower_vision.geometry.line_of_sight import rotation
from follower_vision.images.frame import Image

_AFTER_S = 15.0
_COMES_S, _GOES_S = 12.0, 15.0
_STARTS_M_S2 = 2.0
_CROSSING_DEG = (55.0, 125.0)
_FLIES = "quadrotor"
_LEVELS_M = 0.8

_MARGIN_M = 55.0
_SMALLEST_PX = 1.2
_SIMPLE_PX = 16.0
_ROAD_GOES_ON_M = 200.0
_STAGING = 10_000


def staged(scenario: Scenario, rng: np.random.Generator) -> Scenario:
    """Return the scenario with its shapes, occlusions and look-alikes as plain targets and things.

    A scenario without any comes back as it is.
    """
    if not _is_to_be_staged(scenario):
        return scenario
    until_s = scenario.duration_s + _AFTER_S
    targets = [
        target.model_copy(update={"path": target.path.drawn(rng, until_s)})
        for target in scenario.targets
    ]
    followed = targets[scenario.followed]
    path = followed.path.build()
    others = _look_alikes(scenario, followed, path, rng)
    return scenario.model_copy(
        update={
            "targets": [*targets, *others],
            "scenery": [*scenario.scenery, *canopies(scenario, followed, path)],
        }
    )


def _is_to_be_staged(scenario: Scenario) -> bool:
    shaped = any(target.path.shape is not None for target in scenario.targets)
    return shaped or scenario.occlusions.hidden_s > 0 or scenario.lookalikes.count > 0


def _look_alikes(
    scenario: Scenario, followed: TargetSettings, path: TargetPath, rng: np.random.Generator
) -> Iterator[TargetSettings]:
    """Yield those that cross close behind the target, one after the other."""
    settings = scenario.lookalikes
    for number in range(settings.count):
        near_s = settings.first_s + number * settings.every_s
        pose = path.pose(near_s)
        turn = float(rng.uniform(*_CROSSING_DEG)) * int(rng.choice([-1, 1]))
        height_m = max(0.0, -pose.position_m[2]) + (_LEVELS_M if followed.kind == _FLIES else 0.0)
        ends, speeds = _crossing(pose, math.radians(turn), settings.beside_m, near_s)
        points = [[*place, height_m] for place in ends]
        yield followed.model_copy(update={"path": PathSettings(points=points, speeds=speeds)})


def _crossing(
    pose: TargetPose, turn_rad: float, beside_m: float, near_s: float
) -> tuple[list[Place], list[SpeedChange]]:
    """Return a straight way that passes behind a place at a time, with its speed."""
    speed = max(1.0, math.hypot(*pose.velocity_m_s))
    comes_s, ramp_s = min(_COMES_S, near_s), 1.5 * speed / _STARTS_M_S2
    sets_off_s = max(0.0, near_s - comes_s - ramp_s / 2)
    change = SpeedChange(sets_off_s, speed, _STARTS_M_S2)
    heading, (north, east, _) = pose.heading_rad, pose.position_m
    at = (north - beside_m * math.cos(heading), east - beside_m * math.sin(heading))
    c, s = math.cos(heading + turn_rad), math.sin(heading + turn_rad)
    before_m = SpeedProfile([change]).distance_m(near_s)
    after_m = speed * _GOES_S
    first = (at[0] - before_m * c, at[1] - before_m * s)
    return [first, (at[0] + after_m * c, at[1] + after_m * s)], [change]


def colour_of(text: str) -> Colour:
    """Turn "#rrggbb" into blue, green, red."""
    red, green, blue = (int(text[i : i + 2], 16) for i in (1, 3, 5))
    return blue, green, red


class World:
    """The simulated world: targets that move by the clock, and what stands around them.

    Args:
        scenario: what to build.
        seed: for everything random; the scenario's own if None.

    Attributes:
        begins_s: when the scenario's time is 0, on the clock whose times are asked about; before
            that all stands as it will begin, and infinite is "not yet". None: it is that clock.
    """

    def __init__(self, scenario: Scenario, seed: int | None = None) -> None:
        self.seed = scenario.seed if seed is None else seed
        self.scenario = scenario = staged(scenario, self._rng(_STAGING))
        self.begins_s: float | None = None
        self.paths = [target.path.build() for target in scenario.targets]
        self.wind = Wind(scenario.wind, self._rng(0))
        self.sun = _sun(scenario.sky.sun_azimuth_deg, scenario.sky.sun_elevation_deg)
        self.roads = [self._road(road) for road in scenario.ground.roads]

    def _rng(self, purpose: int) -> np.random.Generator:
        """Return a generator of its own for each purpose, so that none disturbs another."""
        return np.random.default_rng([self.seed, purpose])

    def _road(self, road: RoadSettings) -> Road:
        course = self.paths[road.along].course if road.along is not None else road.build_course()
        line = course.line[:: max(1, round(0.5 * len(course.line) / course.length_m))]
        line = _extended(np.vstack([line, course.line[-1:]]), course)
        return Road(
            line, road.width_m, road.surface == "asphalt", PALETTES[self.scenario.ground.kind].verge
        )

    @cached_property
    def _items(self) -> list[SceneryItem]:
        lines = [path.course.line[::5] for path in self.paths]
        lines += [road.line for road in self.roads]
        lines.append(np.array([[*self.scenario.start.at, 0.0]]))
        items = [*self.scenario.scenery]
        for scatter in self.scenario.scatter:
            items += scattered(scatter, lines, items, self._rng(1 + len(items)))
        return items

    @cached_property
    def scenery(self) -> list[Solid]:
        """What stands and never moves."""
        return [self._standing(scenery_mesh, i) for i in range(len(self._items))]

    def _standing(self, make: Callable[..., Mesh], number: int) -> Solid:
        item, rng = self._items[number], self._rng(100 + number)
        size = float(rng.uniform(*SIZES_M[item.kind])) if item.size_m is None else item.size_m
        turn = rotation(0, 0, math.radians(item.heading_deg))
        if item.kind in ("canopy", "hall"):
            make = partial(make, height_m=item.height_m)
        mesh = make(item.kind, size, rng)
        return Solid.placed(mesh, (*item.at, 0.0), turn, self.sun)

    @cached_property
    def scenery_batch(self) -> SolidBatch:
        """The scenery, ready to be drawn."""
        solids = []
        for number, solid in enumerate(self.scenery):
            if self._items[number].kind in DISTANT_KINDS:
                distant = self._standing(distant_mesh, number)
                solids.append(replace(distant, shown_px=(_SMALLEST_PX, _SIMPLE_PX)))
                solid = replace(solid, shown_px=(_SIMPLE_PX, math.inf))
            solids.append(solid)
        return SolidBatch.of(solids)

    @cached_property
    def ground(self) -> Ground:
        """Pictures of the ground; takes a second or two."""
        shadows = [solid.shadow(self.sun) for solid in self.scenery]
        return make_ground(self.scenario.ground, self.roads, shadows, self._area(), self._rng(2))

    @cached_property
    def sky(self) -> Image:
        """The sky's panorama."""
        hills = self.scenario.ground.kind != "water"
        return panorama(self.haze, self.scenario.sky.clouds, hills, self._rng(3))

    @property
    def haze(self) -> Colour:
        """Colour of the far distance."""
        return PALETTES[self.scenario.ground.kind].haze

    def _area(self) -> tuple[float, float, float, float]:
        """Return the south, west, north and east limit of the scene."""
        points = np.vstack([*(path.course.line for path in self.paths),
                            [[*self.scenario.start.at, 0.0]]])  # fmt: skip
        south, west = points[:, :2].min(axis=0) - _MARGIN_M
        north, east = points[:, :2].max(axis=0) + _MARGIN_M
        return float(south), float(west), float(north), float(east)

    def scene_time(self, time_s: float) -> float:
        """Return the scenario's time at a time of the clock."""
        return time_s if self.begins_s is None else max(0.0, time_s - self.begins_s)

    def is_present(self, number: int, time_s: float) -> bool:
        """Whether a target is in the world; a fault may have taken the followed one out."""
        scene_s = self.scene_time(time_s)
        removed = any(
            fault.kind == "target_removed" and fault.from_s <= scene_s < fault.until_s
            for fault in self.scenario.faults
        )
        return not (removed and number == self.scenario.followed)

    def target_pose(self, number: int, time_s: float) -> TargetPose:
        """Return where a target stands, and how it moves."""
        pose = self.paths[number].pose(self.scene_time(time_s))
        waits = self.begins_s is not None and time_s < self.begins_s
        return replace(pose, velocity_m_s=(0.0, 0.0, 0.0)) if waits else pose

    def target_centre(self, number: int, time_s: float) -> Triple:
        """Return the middle of a target's body: (north, east, down)."""
        north, east, down = self.target_pose(number, time_s).position_m
        return north, east, down - HEIGHTS_M[self.scenario.targets[number].kind] / 2

    def target_solid(self, number: int, time_s: float, lit: bool = True) -> Solid:
        """Return a target's body as it stands in the world, if need be without its light."""
        pose, sun = self.target_pose(number, time_s), self.sun if lit else None
        mesh, turn = self._target_mesh(number, pose), self._target_turn(number, time_s, pose)
        return Solid.placed(mesh, pose.position_m, turn, sun, pose.velocity_m_s)

    def target_corners(self, number: int, time_s: float) -> Vector:
        """Return the corners, (C, 3) north, east and down, of a target's body."""
        pose = self.target_pose(number, time_s)
        mesh, turn = self._target_mesh(number, pose), self._target_turn(number, time_s, pose)
        return np.asarray(product(turn, mesh.corners.T).T + pose.position_m)

    def target_ball(self, number: int, time_s: float) -> BoundingSphere:
        """Return a ball that holds the whole of a target's body, however it leans."""
        pose = self.target_pose(number, time_s)
        return BoundingSphere(pose.position_m, self._target_mesh(number, pose).reach_m)

    def _target_mesh(self, number: int, pose: TargetPose) -> Mesh:
        settings = self.scenario.targets[number]
        travelled = round(pose.distance_m, 2) % 1.5 if settings.kind == "person" else 0.0
        return _target_mesh(settings.kind, settings.colour, travelled)

    def _target_turn(self, number: int, time_s: float, pose: TargetPose) -> Vector:
        settings, path = self.scenario.targets[number], self.paths[number]
        roll, pitch = _lean(settings, path, self.scene_time(time_s))
        return rotation(roll, pitch, pose.heading_rad)

    def moving(self, time_s: float) -> list[Solid]:
        """Return the bodies of all targets present."""
        numbers = range(len(self.paths))
        return [self.target_solid(n, time_s) for n in numbers if self.is_present(n, time_s)]


@lru_cache(maxsize=512)
def _target_mesh(kind: TargetKind, colour: str, travelled_m: float) -> Mesh:
    return target_mesh(kind, colour_of(colour), travelled_m)


def _extended(line: Vector, course: Course) -> Vector:
    """Let a road go straight on at both ends; a closed one is left as it is."""
    if course.closed:
        return line
    reach = np.linspace(0, _ROAD_GOES_ON_M, 400)[1:, None]
    before = line[0] - course.direction(0) * reach[::-1]
    after = line[-1] + course.direction(course.length_m) * reach
    return np.vstack([before, line, after])


def _sun(azimuth_deg: float, elevation_deg: float) -> Vector:
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    level = math.cos(elevation)
    return np.array([level * math.cos(azimuth), level * math.sin(azimuth), -math.sin(elevation)])


def _lean(target: TargetSettings, path: TargetPath, time_s: float) -> tuple[float, float]:
    """Return roll and pitch: a boat rocks, a quadrotor tilts where it accelerates to."""
    if target.kind == "boat":
        return 0.05 * math.sin(1.9 * time_s), 0.035 * math.sin(1.3 * time_s + 1)
    if target.kind != "quadrotor":
        return 0.0, 0.0
    before, now, after = (path.pose(time_s + dt) for dt in (-0.2, 0.0, 0.2))
    north, east = (
        (after.velocity_m_s[i] - before.velocity_m_s[i]) / 0.4 + 0.12 * now.velocity_m_s[i]
        for i in (0, 1)
    )
    c, s = math.cos(now.heading_rad), math.sin(now.heading_rad)
    ahead, right = c * north + s * east, c * east - s * north
    return math.atan2(right, 9.81), -math.atan2(ahead, 9.81)
