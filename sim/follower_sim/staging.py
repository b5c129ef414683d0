"""Sets the scene: turns what a scenario says in a few numbers into paths, canopies and others."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from follower_sim.canopies import canopies
from follower_sim.path_shape import Place
from follower_sim.paths import TargetPath, TargetPose
from follower_sim.scenario import PathSettings, Scenario, TargetSettings
from follower_sim.speed_profile import SpeedChange, SpeedProfile

_AFTER_S = 15.0
_COMES_S, _GOES_S = 12.0, 15.0
_STARTS_M_S2 = 2.0
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
