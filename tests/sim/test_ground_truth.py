"""The truth about the target, as the score needs it."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from follower_sim.kinematics import BodyState
from follower_sim.scoring.ground_truth import GroundTruth
from follower_sim.view import CameraView
from follower_sim.world.painter import LensProjection, SolidBatch, SolidPainter
from follower_sim.world.world import World
from follower_vision.geometry.line_of_sight import LineOfSight

HOVER = BodyState(10, (0.0, 0.0, -6.0))


def turned(yaw_deg: float) -> BodyState:
    return BodyState(10, HOVER.position_m, attitude_rad=(0, 0, math.radians(yaw_deg)))


def test_range_and_line_of_sight(small_world: World) -> None:
    truth = GroundTruth(small_world).sample(10, turned(30))
    assert truth.range_m == pytest.approx(math.hypot(15, 6 - 0.75))
    assert math.degrees(truth.azimuth_rad) == pytest.approx(-30)
    elevation = -math.degrees(math.atan2(6 - 0.75, 15))
    assert math.degrees(truth.elevation_rad) == pytest.approx(elevation)
    assert truth.target_position_m == pytest.approx((15, 0, -0.75))


@pytest.mark.parametrize("roll_deg", [0, 25])
@pytest.mark.parametrize("distortion", [(0, 0, 0, 0, 0), (-0.1, 0.02, 0, 0, 0)])
def test_the_box_is_the_silhouettes_box(
    make_world: Callable[..., World], roll_deg: float, distortion: tuple[float, ...]
) -> None:
    world = make_world(camera={"width": 640, "height": 480, "distortion": distortion})
    body = BodyState(10, HOVER.position_m, attitude_rad=(math.radians(roll_deg), 0, 0.2))
    box = GroundTruth(world).seen(10, body).box
    view = CameraView.of(body, world.scenario.camera.mount)
    painter = SolidPainter(LensProjection(world.scenario.camera.model))
    image = np.zeros((480, 640, 3), np.uint8)
    car = world.target_solid(0, 10)
    white = SolidBatch.of([replace(car, colours=np.full_like(car.colours, 255))])
    painter.paint(image, painter.select([white], view), view)
    rows, columns = np.nonzero(image[..., 0] > 127)
    assert (box.left, box.right) == pytest.approx((columns.min(), columns.max() + 1), abs=1.6)
    assert (box.top, box.bottom) == pytest.approx((rows.min(), rows.max() + 1), abs=1.6)


def test_half_out_of_the_image_is_half_in_frame(small_world: World) -> None:
    seen = GroundTruth(small_world).seen
    shares = [seen(10, turned(yaw)).in_frame_share for yaw in range(0, 70, 2)]
    assert shares[0] == 1
    assert shares[-1] == 0
    assert any(0.3 < share < 0.7 for share in shares)
    assert (np.diff(shares) <= 1e-9).all()


def test_behind_the_camera_there_is_no_box(small_world: World) -> None:
    truth = GroundTruth(small_world)
    seen, sample = truth.seen(10, turned(180)), truth.sample(10, turned(180))
    assert seen.box is None
    assert seen.in_frame_share == 0
    assert abs(sample.azimuth_rad) == pytest.approx(math.pi)


@pytest.mark.parametrize(
    ("north", "least", "most"), [(8.5, 0.0, 0.02), (30.0, 1.0, 1.0), (-20.0, 1.0, 1.0)]
)
def test_a_house_hides_only_what_is_behind_it(
    make_world: Callable[..., World], north: float, least: float, most: float
) -> None:
    world = make_world(
        scenery=[{"kind": "house", "at": [north, 0], "size_m": 9, "heading_deg": 90}]
    )
    truth = GroundTruth(world).seen(10, BodyState(10, (-3.0, 0.0, -2.0)))
    assert least <= truth.visible_share <= most


@pytest.mark.parametrize("yaw_deg", [-15.0, 0.0, 20.0])
def test_the_boxes_middle_is_seen_where_the_box_is(small_world: World, yaw_deg: float) -> None:
    truth = GroundTruth(small_world)
    sample = truth.sample(10, turned(yaw_deg))
    sight = truth.box_sight(sample)
    assert sight.azimuth_rad == pytest.approx(sample.azimuth_rad, abs=0.02)
    assert sight.elevation_rad == pytest.approx(sample.elevation_rad, abs=0.05)
    assert sight != LineOfSight(sample.azimuth_rad, sample.elevation_rad)
    behind = truth.sample(10, turned(180))
    assert truth.box_sight(behind) == LineOfSight(behind.azimuth_rad, behind.elevation_rad)


def test_what_is_out_of_view_is_hidden_only_if_something_stands_before_it(
    make_world: Callable[..., World],
) -> None:
    house = {"kind": "house", "at": [8.5, 0], "size_m": 9, "heading_deg": 90}
    looks_away = BodyState(10, (-3.0, 0.0, -2.0), attitude_rad=(0.0, 0.0, math.pi))
    behind, free = (
        GroundTruth(make_world(scenery=things)).seen(10, looks_away) for things in ([house], [])
    )
    assert behind.box is free.box is None
    assert behind.visible_share < 0.05
    assert free.visible_share == 1.0


def test_a_high_canopy_hides_what_flies_below_it(
    make_world: Callable[..., World],
) -> None:
    roof = {"kind": "canopy", "at": [15, 0], "size_m": 6, "heading_deg": 0, "height_m": 10}
    drone = {
        "kind": "quadrotor",
        "colour": "#e0401c",
        "path": {"points": [[16, 0, 9], [40, 0, 9]]},
    }
    world = make_world(scenery=[roof], targets=[drone])
    assert GroundTruth(world).seen(10, BodyState(10, (8.0, 0.0, -14.0))).visible_share < 0.05


def test_another_car_hides_the_followed_one_partly(make_world: Callable[..., World]) -> None:
    followed = {"kind": "car", "colour": "#e0401c", "path": {"points": [[15, 0], [25, 0]]}}
    crossing = {"kind": "car", "colour": "#2040c0", "path": {"points": [[9, 1.2], [9, 30]]}}
    world = make_world(targets=[followed, crossing])
    truth = GroundTruth(world).seen(10, BodyState(10, (0.0, 0.0, -2.4)))
    assert 0.05 < truth.visible_share < 0.95


def test_a_removed_target_is_not_in_frame(make_world: Callable[..., World]) -> None:
    world = make_world(faults=[{"kind": "target_removed", "from_s": 5, "until_s": 8}])
    shares = [GroundTruth(world).seen(t, HOVER).in_frame_share for t in (4, 6, 9)]
    assert shares == [1, 0, 1]


def test_the_sample_for_the_score_says_the_same(small_world: World) -> None:
    truth = GroundTruth(small_world)
    seen, sample = truth.seen(10, turned(10)), truth.sample(10, turned(10))
    assert (sample.time_s, sample.vehicle) == (10, turned(10))
    assert sample.in_frame_share == seen.in_frame_share
    assert sample.visible_share == seen.visible_share
