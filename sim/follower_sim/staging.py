"""Sets the scene: turns what a scenario says in a few numbers into paths, canopies and others."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from follower_sim.path_shape import Place
from follower_sim.paths import TargetPath, TargetPose
from follower_sim.scenario import (
    OcclusionSettings,
    PathSettings,
    Scenario,
    SceneryItem,
    TargetSettings,
)
from follower_sim.speed_profile import SpeedChange, SpeedProfile
from follower_sim.targets import HEIGHTS_M

_AFTER_S = 15.0
_COMES_S, _GOES_S = 12.0, 15.0
_STARTS_M_S2 = 2.0
_PIECE_M = 3.0
_OVERLAP = 0.75
_LEAST_M = 0.5
_CLEAR_M = 14.0
_CROSSING_DEG = (55.0, 125.0)
_FLIES = "quadrotor"
_LEVELS_M = 0.8


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
            "scenery": [*scenario.scenery, *_canopies(scenario, followed, path)],
        }
    )


def _is_to_be_staged(scenario: Scenario) -> bool:
    shaped = any(target.path.shape is not None for target in scenario.targets)
    return shaped or scenario.occlusions.hidden_s > 0 or scenario.lookalikes.count > 0


def _canopies(
    scenario: Scenario, followed: TargetSettings, path: TargetPath
) -> Iterator[SceneryItem]:
    """Yield the pieces of roof above what the target passes while it is to be hidden.

    None stands where the target waits at first, or it could not be pointed out.
    """
    settings, (north, east, _) = scenario.occlusions, path.pose(0.0).position_m
    if settings.hidden_s <= 0:
        return
    for number in range(settings.count):
        from_s = settings.first_s + number * settings.every_s
        first_m = path.pose(from_s).distance_m
        length_m = max(_LEAST_M, path.pose(from_s + settings.hidden_s).distance_m - first_m)
        for along_m, piece_m in _pieces(first_m, length_m):
            roof = _roof(path, along_m, piece_m, followed, settings)
            if math.dist(roof.at, (north, east)) > _CLEAR_M:
                yield roof


def _pieces(first_m: float, length_m: float) -> Iterator[tuple[float, float]]:
    """Yield the middle of each piece along the course, and its length."""
    count = max(1, math.ceil(length_m / (_PIECE_M * _OVERLAP)))
    step_m = length_m / count
    piece_m = step_m if count == 1 else step_m / _OVERLAP
    yield from ((first_m + (i + 0.5) * step_m, piece_m) for i in range(count))


def _roof(
    path: TargetPath,
    along_m: float,
    piece_m: float,
    followed: TargetSettings,
    settings: OcclusionSettings,
) -> SceneryItem:
    north, east, down = (float(x) for x in path.course.position(along_m))
    direction = path.course.direction(along_m)
    heading = math.degrees(math.atan2(float(direction[1]), float(direction[0])))
    height_m = HEIGHTS_M[followed.kind] + settings.clearance_m - down
    return SceneryItem(
        kind=settings.kind,
        at=(north, east),
        heading_deg=heading,
        size_m=piece_m,
        height_m=height_m,
    )


def _look_alikes(
    scenario: Scenario, followed: TargetSettings, path: TargetPath, rng: np.random.Generator
) -> Iterator[TargetSettings]:
    """Yield those that cross close behind the target, one after the other."""
    settings = scenario.lookalikes
    for number in range(settings.count):
        near_s = settings.first_s + number * settings.every_s
        pose = path.pose(near_s)
        turn = float(rng.uniform(*_CROSSING_DEG)) * int(rng.choice([-1, 1]))
        height_m = -pose.position_m[2] + (_LEVELS_M if followed.kind == _FLIES else 0.0)
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
