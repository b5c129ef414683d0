"""Paths by shape, canopies that hide, look-alikes that cross: drawn from the seed, as promised."""

import math
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from follower_sim.kinematics import BodyState
from follower_sim.paths.path_generator import PathShape, ShapeKind, drawn
from follower_sim.scenario.scenario import PathSettings, Scenario
from follower_sim.scenario.scenario_file import load_scenario
from follower_sim.scoring.ground_truth import GroundTruth
from follower_sim.scoring.occlusions import HIDDEN
from follower_sim.world.scenery import follower_place
from follower_sim.world.world import World

FOLDER = Path(__file__).parents[2] / "configs" / "scenarios"
KINDS = get_args(ShapeKind)
SPEED, FROM_S, UNTIL_S = 5.0, 10.0, 70.0
FIRST_S, ASKED_S = 26.0, 3.0


def shaped(kind: ShapeKind, **more: Any) -> PathSettings:
    shape = {"kind": kind, "speed_m_s": SPEED, "from_s": FROM_S, "acceleration_m_s2": 2.2, **more}
    return PathSettings.model_validate({"shape": shape})


def changed(name: str, **keys: Any) -> Scenario:
    data = load_scenario(FOLDER / f"{name}.yaml").model_dump(mode="json")
    for key, value in keys.items():
        data[key] = value
    return Scenario.model_validate(data)


@pytest.mark.slow
@settings(max_examples=20)
@given(st.sampled_from(KINDS), st.integers(0, 10_000))
def test_a_shape_lasts_and_its_target_accelerates_as_a_real_one_could(
    kind: ShapeKind, seed: int
) -> None:
    path = shaped(kind).build(seed, UNTIL_S)
    assert path.shortfall_m(UNTIL_S) == 0
    velocities = np.array([path.pose(t).velocity_m_s for t in np.arange(0, UNTIL_S, 0.2)])
    assert np.linalg.norm(np.diff(velocities, axis=0), axis=1).max() / 0.2 < 4.5
    assert np.linalg.norm(velocities, axis=1).max() <= 1.2 * SPEED + 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_shape_stands_until_it_sets_off_in_its_direction(kind: ShapeKind) -> None:
    settings = shaped(kind, start=(3.0, -2.0), heading_deg=60.0, height_m=7.0)
    path = settings.build(1, UNTIL_S)
    assert path.pose(FROM_S).position_m == pytest.approx((3.0, -2.0, -7.0))
    later = path.pose(FROM_S + 2.5)
    assert math.hypot(*later.velocity_m_s) > 0.5
    assert math.degrees(later.heading_rad) == pytest.approx(60, abs=35)


def test_a_seed_draws_the_same_path_and_another_seed_another_one() -> None:
    shape = PathShape("evasive", SPEED)
    first, again, other = (drawn(shape, np.random.default_rng(s), UNTIL_S) for s in (1, 1, 2))
    assert first == again
    assert first["points"] != other["points"]


def test_stop_and_go_stops_and_goes() -> None:
    path = shaped("stop-and-go").build(0, UNTIL_S)
    speeds = np.array([math.hypot(*path.pose(t).velocity_m_s) for t in range(10, 70)])
    starts = np.count_nonzero((speeds[:-1] < 0.1) & (speeds[1:] >= 0.1))
    assert starts >= 3
    assert speeds.max() > 0.7 * SPEED


def test_a_figure_eight_comes_back_through_its_crossing() -> None:
    path = shaped("figure-eight", scale_m=20).build(0, UNTIL_S)
    places = np.array([path.pose(t).position_m for t in np.arange(FROM_S, UNTIL_S, 0.1)])
    away = np.linalg.norm(places, axis=1)
    assert away.max() == pytest.approx(20, rel=0.1)
    assert np.count_nonzero((away[1:] < 2) & (away[:-1] >= 2)) >= 3


def test_a_path_has_either_points_or_a_shape() -> None:
    with pytest.raises(ValidationError, match="either points and speeds or a shape"):
        PathSettings.model_validate(
            {"points": [[0, 0], [9, 0]], "shape": {"kind": "straight", "speed_m_s": 1}}
        )
    with pytest.raises(ValidationError, match="speed_m_s is finite and positive"):
        PathSettings.model_validate({"shape": {"kind": "straight", "speed_m_s": 0}})
    with pytest.raises(ValidationError, match="at least 2 points"):
        PathSettings.model_validate({})


def hidden_s(name: str, kind: str, goes_on: bool, seed: int) -> list[float]:
    """Return how long a follower of a target does not see it, each time."""
    base = load_scenario(FOLDER / f"pursue-{name}.yaml")
    shape = {**base.targets[0].path.model_dump(mode="json")["shape"], "kind": kind}
    target = {**base.targets[0].model_dump(mode="json"), "path": {"shape": shape}}
    roofs = base.occlusions.model_dump(mode="json")
    roofs.update(hidden_s=ASKED_S, count=1, first_s=FIRST_S)
    world = World(changed(f"pursue-{name}", targets=[target], scatter=[], occlusions=roofs), seed)
    truth, path = GroundTruth(world), world.paths[0]
    distance_m, down = roofs["distance_m"], math.radians(roofs["down_deg"])
    hidden: list[float] = []
    before, stopped_s = False, math.inf
    for time_s in np.arange(FIRST_S - 2.0, FIRST_S + 20.0, 0.1).tolist():
        flown_s = min(time_s, stopped_s)
        north, east, _ = follower_place(path, flown_s, distance_m * math.cos(down))
        target_at = world.target_centre(0, time_s)
        height = world.target_centre(0, flown_s)[2] - distance_m * math.sin(down)
        yaw = math.atan2(target_at[1] - east, target_at[0] - north)
        body = BodyState(time_s, (north, east, height), attitude_rad=(0.0, 0.0, yaw))
        now = truth.seen(time_s, body).visible_share < HIDDEN
        if now:
            hidden = hidden if before else [*hidden, 0.0]
            hidden[-1] += 0.1
            stopped_s = stopped_s if goes_on else flown_s
        before = now
    return hidden


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("person", "winding"),
        ("car", "straight"),
        ("car", "winding"),
        ("car", "stop-and-go"),
        ("boat", "winding"),
        ("quadrotor", "stop-and-go"),
    ],
)
def test_a_canopy_hides_the_target_for_as_long_as_was_asked_from_one_that_stops(
    name: str, kind: str
) -> None:
    (standing,) = hidden_s(name, kind, goes_on=False, seed=5)
    assert standing == pytest.approx(ASKED_S, abs=0.6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["person", "car", "boat", "quadrotor"])
def test_a_canopy_hides_the_target_for_less_from_one_that_goes_on(name: str) -> None:
    (going_on,) = hidden_s(name, "straight", goes_on=True, seed=5)
    assert 0.55 * ASKED_S < going_on < ASKED_S


def test_a_canopy_without_a_distance_stands_above_the_way_for_so_long() -> None:
    hiding = {"hidden_s": ASKED_S, "count": 1, "first_s": FIRST_S}
    world = World(changed("pursue-car", scatter=[], occlusions=hiding))
    path = world.paths[0]
    for item in world.scenario.scenery:
        away = [
            math.dist(item.at, path.pose(float(t)).position_m[:2])
            for t in np.arange(FIRST_S, FIRST_S + ASKED_S + 0.05, 0.05)
        ]
        assert min(away) < 0.2


@pytest.mark.parametrize("kind", ["canopy", "hall"])
def test_a_roof_stands_as_high_above_the_target_as_was_asked(kind: str) -> None:
    heights_m = []
    for clearance_m in (0.6, 2.0):
        roofs = {"kind": kind, "hidden_s": 2.0, "clearance_m": clearance_m}
        world = World(changed("pursue-car", occlusions=roofs, scenery=[], scatter=[]))
        heights_m.append(-min(solid.vertices[:, 2].min() for solid in world.scenery))
    assert heights_m[1] - heights_m[0] == pytest.approx(1.4)


def test_no_canopy_stands_where_the_target_is_pointed_out() -> None:
    base = load_scenario(FOLDER / "pursue-person.yaml")
    shape = {"kind": "figure-eight", "speed_m_s": 1.5, "scale_m": 14.0}
    target = {**base.targets[0].model_dump(mode="json"), "path": {"shape": shape}}
    hiding = {"hidden_s": 5.0, "count": 4, "first_s": 20.0, "every_s": 10.0}
    world = World(changed("pursue-person", targets=[target], scatter=[], occlusions=hiding), 3)
    places = [item.at for item in world.scenario.scenery]
    assert places, "the eight leads away from where it begins"
    assert min(math.hypot(*place) for place in places) > 9


def test_look_alikes_cross_close_behind_the_target_when_they_are_to() -> None:
    others = {"count": 2, "first_s": 30.0, "every_s": 8.0, "beside_m": 3.0}
    world = World(changed("pursue-car", lookalikes=others))
    assert [target.colour for target in world.scenario.targets] == ["#e0401c"] * 3
    for number, time_s in ((1, 30.0), (2, 38.0)):
        target, other = (world.target_centre(n, time_s) for n in (0, number))
        assert math.dist(target, other) == pytest.approx(3.0, abs=0.05)
        assert math.dist(world.target_centre(0, 12.0), world.target_centre(number, 12.0)) > 20


def test_the_seed_of_the_world_draws_the_path() -> None:
    scenario = load_scenario(FOLDER / "pursue-car.yaml")
    worlds = [World(scenario, seed) for seed in (1, 1, 2)]
    places = [world.target_centre(0, 40.0) for world in worlds]
    assert places[0] == places[1] != places[2]
    assert worlds[0].scenario.targets[0].path.shape is None


def test_a_scenario_without_shapes_is_left_as_it_is() -> None:
    scenario = load_scenario(FOLDER / "winding.yaml")
    assert World(scenario).scenario is scenario
