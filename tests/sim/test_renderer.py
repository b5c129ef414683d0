"""Whole pictures: what is in them, motion blur, and the same picture for the same seed."""

import math
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from follower_sim.kinematics import BodyState
from follower_sim.scoring.ground_truth import GroundTruth
from follower_sim.world.render import Renderer
from follower_sim.world.world import World
from follower_vision.selection import ColourSearchSettings, colour_from_hex, find_by_colour

HOVER = BodyState(10, (0.0, 0.0, -6.0))


@pytest.fixture(scope="module")
def renderer(small_world: World) -> Renderer:
    return Renderer(small_world)


def sharpness(image: np.ndarray) -> float:
    return float(cv2.Laplacian(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), cv2.CV_64F).var())


@pytest.mark.slow
def test_the_car_is_drawn_where_the_truth_says(small_world: World, renderer: Renderer) -> None:
    image = renderer.render(10, HOVER)
    truth = GroundTruth(small_world).seen(10, HOVER)
    found = find_by_colour(image, colour_from_hex("#e0401c"), ColourSearchSettings())[0]
    assert found.iou(truth.box) > 0.7
    assert abs(found.cx - truth.box.cx) < 2


def test_the_sky_is_bluer_than_the_ground(renderer: Renderer) -> None:
    image = renderer.render(10, HOVER).astype(float)
    sky, ground = image[:10].mean(axis=(0, 1)), image[-60:].mean(axis=(0, 1))
    assert sky[0] > sky[2]
    assert ground[1] > ground[0] + 20


@pytest.mark.parametrize("rates", [(0, 0, 1.5), (0, 1.5, 0), (1.5, 0, 0)])
def test_turning_blurs_the_picture(renderer: Renderer, rates: tuple[float, float, float]) -> None:
    turning = BodyState(10, HOVER.position_m, rates_rad_s=rates)
    sharp, blurred = renderer.render(10, turning), renderer.render(10, turning, 0.012)
    assert sharpness(blurred) < 0.8 * sharpness(sharp)


def test_motion_blur_is_centred_on_the_middle_of_the_exposure(renderer: Renderer) -> None:
    turning = BodyState(10, HOVER.position_m, rates_rad_s=(0, 0, 1.2))
    sharp, blurred = (
        cv2.cvtColor(renderer.render(10, turning, exposure), cv2.COLOR_BGR2GRAY)
        for exposure in (0.0, 0.02)
    )
    shift, _ = cv2.phaseCorrelate(sharp.astype(np.float64), blurred.astype(np.float64))
    assert math.hypot(*shift) < 0.3


@pytest.mark.slow
def test_the_car_is_as_sharp_as_before_when_the_camera_moves_along(
    make_world: Callable[..., World],
) -> None:
    driving = {"points": [[15, 0], [60, 0]], "speeds": [{"at_s": 0, "speed_m_s": 1.0}]}
    world = make_world(targets=[{"kind": "car", "colour": "#e0401c", "path": driving}])
    renderer = Renderer(world)
    body = BodyState(0, (0.0, 0.0, -6.0), (1.0, 0.0, 0.0))
    still, along = renderer.render(0, body), renderer.render(0, body, 0.01)
    box = GroundTruth(world).seen(0, body).box
    rows, columns = slice(int(box.top), int(box.bottom)), slice(int(box.left), int(box.right))
    difference = cv2.absdiff(still, along)[rows, columns]
    assert float(np.median(difference)) <= 2


@pytest.mark.slow
def test_the_same_seed_draws_the_same_picture(make_world: Callable[..., World]) -> None:
    scatter = [{"kind": "fir", "count": 5, "clear_m": 5, "within_m": 30}]
    pictures = [
        Renderer(make_world(seed=seed, scatter=scatter)).render(3, HOVER) for seed in (1, 1, 2)
    ]
    assert np.array_equal(pictures[0], pictures[1])
    assert not np.array_equal(pictures[0], pictures[2])


def test_the_picture_at_the_ground_before_take_off_is_drawn(renderer: Renderer) -> None:
    image = renderer.render(0, BodyState(0, (0.0, 0.0, 0.0)))
    assert image.shape == (240, 320, 3)
    assert image.std() > 5


@pytest.mark.parametrize("attitude", [(3.1, 0.0, 0.0), (0.0, 1.5, 2.0), (0.0, -1.5, -2.0)])
def test_any_attitude_can_be_drawn(
    renderer: Renderer, attitude: tuple[float, float, float]
) -> None:
    image = renderer.render(0, BodyState(0, (5.0, 2.0, -30.0), attitude_rad=attitude), 0.01)
    assert image.std() > 1


def test_the_sky_overhead_is_the_same_whichever_way_the_camera_is_turned(
    renderer: Renderer,
) -> None:
    up = math.radians(90 + 20)  # the camera is mounted 20 degrees down
    one, other = (
        renderer.render(1, BodyState(1, (0.0, 0.0, -6.0), attitude_rad=(0.0, up, yaw)))
        for yaw in (0.0, math.pi)
    )
    apart = cv2.absdiff(one, cv2.rotate(other, cv2.ROTATE_180))
    assert np.count_nonzero(apart.max(axis=2) > 12) < 0.002 * apart.shape[0] * apart.shape[1]


@pytest.mark.slow
def test_a_scene_of_many_kilometres_is_drawn(make_world: Callable[..., World]) -> None:
    path = {"points": [[15, 0], [20_000, 0]]}
    world = make_world(targets=[{"kind": "car", "colour": "#e0401c", "path": path}])
    image = Renderer(world).render(3.0, BodyState(3.0, (0.0, 0.0, -8.0)))
    assert image[-1, :, 1].mean() > image[-1, :, 0].mean()  # meadow


def test_scenery_keeps_clear_of_the_path(make_world: Callable[..., World]) -> None:
    scatter = [{"kind": "broadleaf", "count": 30, "clear_m": 8, "within_m": 40}]
    world = make_world(scatter=scatter)
    assert len(world.scenery) == 30
    line = world.paths[0].course.line[:, :2]
    for tree in world.scenery:
        trunk = tree.vertices[tree.vertices[:, 2] > -0.01][:, :2].mean(axis=0)
        assert np.linalg.norm(line - trunk, axis=1).min() >= 7.5


def test_wind_blows_from_where_it_is_said_to(make_world: Callable[..., World]) -> None:
    world = make_world(wind={"mean_m_s": 5, "from_deg": 90, "gust_m_s": 1.0})
    samples = np.array([world.wind.velocity_m_s(t) for t in np.arange(0, 600, 0.25)])
    assert samples.mean(axis=0) == pytest.approx((0, -5, 0), abs=0.1)
    assert samples.std(axis=0) == pytest.approx((1, 1, 1 / 3), rel=0.15)
