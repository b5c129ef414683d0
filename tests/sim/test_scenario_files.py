"""Scenario files: strict, with errors that say where and what; the shipped ones can be flown."""

import math
from pathlib import Path

import pytest
import yaml

from follower.simulation.components import gimbal_of
from follower_control.common.strict_config import SettingsError
from follower_sim.kinematics import BodyState
from follower_sim.scenario.scenario import Scenario
from follower_sim.scenario.scenario_file import load_scenario
from follower_sim.scoring.ground_truth import GroundTruth
from follower_sim.world.render import Renderer
from follower_sim.world.world import World
from follower_vision.selection import colour_from_hex, find_by_colour

FOLDER = Path(__file__).parents[2] / "configs" / "scenarios"
SHIPPED = sorted(FOLDER.glob("*.yaml"))
MINIMAL = """
name: minimal
title: A car drives straight on.
duration_s: 10
targets:
  - kind: car
    colour: "#e0401c"
    path: {points: [[0, 0], [100, 0]], speeds: [{at_s: 1, speed_m_s: 5}]}
start: {at: [-15, 0]}
select: {colour: "#e0401c"}
"""
SPEEDS = "{points: [[0, 0], [100, 0]], speeds: [{at_s: 1, speed_m_s: 5}]}"


def written(folder: Path, text: str) -> Path:
    path = folder / "scenario.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_minimal_scenario_is_enough(tmp_path: Path) -> None:
    scenario = load_scenario(written(tmp_path, MINIMAL))
    assert scenario.camera.rate_hz == 30
    assert scenario.followed == 0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("duration_s", "duration", "unknown key 'duration'; did you mean 'duration_s'?"),
        ("speed_m_s", "speed_ms", "unknown key 'targets[0].path.speeds[0].speed_ms'; did you mean"),
        ("kind: car", "kind: tank", "targets[0].kind: Input should be 'person', 'car'"),
        ("#e0401c", "orange", "targets[0].colour: String should match"),
        ("[100, 0]", "[20, 0]", "the path of target number 0 is 16 m too short for its speeds"),
        ("at_s: 1", "at_s: -1", "targets[0].path.speeds[0]: a speed change needs a time"),
        (
            "duration_s: 10",
            "duration_s: ten",
            "duration_s: 'ten' is no number; write one alone, in seconds",
        ),
        ("duration_s: 10", "duration_s: .nan", "duration_s: Input should be"),
        ("duration_s: 10", "duration_s: 10\nfollowed: 1", "there is no target number 1"),
        ("start:", "starts:", "unknown key 'starts'; did you mean 'start'?"),
        ("name: minimal", "name: [", "no valid YAML"),
        (
            "start:",
            "camera: {fov_deg: 90, distortion: [-0.6, 0, 0, 0, 0]}\nstart:",
            "camera: with this distortion the lens cannot image its own corners",
        ),
        ("start:", "ground: {roads: [{width_m: 5}]}\nstart:", "a road needs either `along`"),
        (
            "start:",
            "scatter: [{kind: fir, count: 1, size_m: [9, 2]}]\nstart:",
            "scatter[0]: size_m: the smallest size comes first",
        ),
        ("start:", "stand_in: {size_noise: 1.0e+9}\nstart:", "size_noise lies between 0 and 10"),
        ("[100, 0]", "[100, 0, -1]", "targets[0].path: a path's heights are 0 or more"),
        ("[-15, 0]", "[1.0e+9, 0]", "start.at[0]: Input should be less than"),
        ("[100, 0]", "[1.0e+9, 0]", "a course is at most 100 km long"),
        (SPEEDS, "{shape: {kind: winding, speed_m_s: 1.0e+9}}", "a course is at most 100 km long"),
        (
            SPEEDS,
            "{shape: {kind: winding, speed_m_s: 5, scale_m: 1.0e-9}}",
            "targets[0].path.shape: scale_m lies between 1 and 100000, not 1e-09",
        ),
        ("duration_s: 10", "duration_s: 1.0e+12", "duration_s: Input should be less than"),
        (
            "start:",
            "occlusions: {hidden_s: 1.0e+6}\nstart:",
            "occlusions.hidden_s: Input should be",
        ),
        (
            "start:",
            "wind: {mean_m_s: 1.0e+200}\nstart:",
            "wind.mean_m_s: Input should be less than",
        ),
        ("start:", "camera: {latency_s: 2.5}\nstart:", "camera.latency_s: Input should be"),
    ],
)
def test_mistakes_are_named_in_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = written(tmp_path, MINIMAL.replace(old, new))
    with pytest.raises(SettingsError) as caught:
        load_scenario(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_all_that_is_missing_and_settings_in_a_scenario_s_place_are_named(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("name: x")
    with pytest.raises(SettingsError, match=r"title, duration_s, .*start.*: missing"):
        load_scenario(path)
    path.write_text("servo: {distance_m: 9}")
    with pytest.raises(SettingsError, match="these are settings: give them by -c"):
        load_scenario(path)


def test_a_number_of_a_list_is_written_in_digits(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="'²' is no number from 0 to 0"):
        load_scenario(written(tmp_path, MINIMAL), ["targets.².kind=boat"])


def test_all_values_given_beside_the_file_are_named_with_a_wrong_one(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"duration_s=-1 --scene wind.gust_m_s=1: "):
        load_scenario(written(tmp_path, MINIMAL), ["duration_s=-1", "wind.gust_m_s=1"])


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"nowhere\.yaml: cannot be read: No such file"):
        load_scenario(tmp_path / "nowhere.yaml")


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_a_shipped_scenario_is_named_after_its_file_and_has_a_sentence_for_a_title(
    path: Path,
) -> None:
    scenario = load_scenario(path)
    assert scenario.name == path.stem
    assert scenario.title.endswith(".")
    assert 30 <= scenario.duration_s <= 80


@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_a_shipped_target_drives_as_a_real_one_could(path: Path) -> None:
    scenario = load_scenario(path)
    target = scenario.targets[scenario.followed].path.build()
    for step in range(int(scenario.duration_s * 10)):
        before, after = (target.pose(step / 10 + dt).velocity_m_s for dt in (0, 0.1))
        acceleration = math.dist(before, after) / 0.1
        assert acceleration < 4.0


@pytest.mark.slow
@pytest.mark.parametrize("path", SHIPPED, ids=lambda p: p.stem)
def test_a_shipped_target_can_be_found_by_its_colour_after_take_off(path: Path) -> None:
    world = World(load_scenario(path))
    scenario = world.scenario
    heading = math.radians(scenario.start.heading_deg)
    north, east = scenario.start.at
    body = BodyState(
        10.0, (north, east, -scenario.takeoff_height_m), attitude_rad=(0.0, 0.0, heading)
    )
    gimbal = gimbal_of(scenario)
    camera = body if gimbal is None else gimbal.camera(body)
    truth = GroundTruth(world).seen(10.0, camera)
    image = Renderer(world).render(10.0, camera)
    select = scenario.select
    found = find_by_colour(image, colour_from_hex(select.colour), select.search)
    assert truth.in_frame_share > 0.999
    assert truth.visible_share > 0.9
    assert truth.box is not None
    assert found[0].iou(truth.box) > 0.4


@pytest.fixture
def winding() -> Scenario:
    return load_scenario(FOLDER / "winding.yaml")


def test_yaml_says_it_all(winding: Scenario) -> None:
    assert (
        Scenario.model_validate(yaml.safe_load(yaml.safe_dump(winding.model_dump(mode="json"))))
        == winding
    )
