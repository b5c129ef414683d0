"""The scenario `demo`: its hall hides the car, its look-alike crosses, its camera shakes."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from follower_sim.camera import SimCamera
from follower_sim.kinematics import BodyState
from follower_sim.scenario.scenario_file import load_scenario
from follower_sim.scoring.ground_truth import GroundTruth
from follower_sim.world.world import World
from follower_vision.images.frame import Image

FILE = Path(__file__).parents[2] / "configs" / "scenarios" / "demo.yaml"


@pytest.fixture(scope="module")
def world() -> World:
    return World(load_scenario(FILE))


def behind(time_s: float) -> BodyState:
    """Where a drone that follows from behind has come to before the hall."""
    return BodyState(time_s, (55.0, 0.0, -5.8), attitude_rad=(0.0, 0.0, 0.15))


@pytest.mark.slow
def test_the_car_is_wholly_hidden_for_three_seconds_and_stays_in_the_frame(world: World) -> None:
    seen_at = GroundTruth(world).seen
    times = np.arange(24.0, 34.0, 0.1)
    truth = [seen_at(float(time_s), behind(float(time_s))) for time_s in times]
    visible = np.array([one.visible_share for one in truth])
    assert visible[0] > 0.8
    assert visible[-1] > 0.8
    assert 2.5 <= 0.1 * (visible < 0.05).sum() <= 4.5
    assert all(one.in_frame_share > 0.9 for one in truth[20:])


def test_the_look_alike_is_in_sight_while_the_car_is_not(world: World) -> None:
    others = GroundTruth(world).others(28.5, behind(28.5))
    assert len(others) == 1
    width, height = world.scenario.camera.width, world.scenario.camera.height
    assert others[0].visible_share(width, height) > 0.9


@pytest.mark.slow
def test_a_shaken_camera_gives_blurred_pictures_for_its_time_alone() -> None:
    scenario = load_scenario(FILE)
    fault = scenario.faults[0]
    assert fault.kind == "shaken"
    camera = scenario.camera.model_copy(update={"drop_probability": 0.0, "noise": 0.0})
    world = World(scenario.model_copy(update={"camera": camera}))
    taken = SimCamera(world, lambda time_s: replace(behind(time_s), position_m=(35.0, 0.0, -5.8)))
    sharp = {}
    for time_s in (fault.from_s - 0.2, 0.5 * (fault.from_s + fault.until_s), fault.until_s + 0.2):
        taken.next_capture_s = time_s
        delivery = taken.capture()
        sharp[time_s] = sharpness(delivery.frame.image)
    before, during, after = sharp.values()
    assert during < 0.4 * min(before, after)


def sharpness(image: Image) -> float:
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return float(cv2.Laplacian(grey, cv2.CV_64F).var())
