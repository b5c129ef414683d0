"""What is drawn is where the camera model says: bodies, ground, horizon."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from follower_sim.bodies.mesh import ball, box
from follower_sim.kinematics import BodyState
from follower_sim.view import CameraView
from follower_sim.world.ground import GroundPainter, PixelRays
from follower_sim.world.ground_pyramid import Ground, GroundMap, GroundPyramid
from follower_sim.world.painter import LensProjection, SolidBatch, SolidPainter
from follower_sim.world.render import pixel_rays
from follower_sim.world.solid import Solid
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.geometry.line_of_sight import CameraMount

LEVEL = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
STRAIGHT = CameraModel.from_fov(320, 240, math.radians(75))
BARREL = CameraModel.from_fov(320, 240, math.radians(75), (-0.2, 0.03, 0.001, -0.001, 0.0))
PINCUSHION = CameraModel.from_fov(320, 240, math.radians(60), (0.12, 0.02, 0.0, 0.002, 0.0))
MOUNT = CameraMount(pitch_rad=math.radians(-20))
UP = np.array([0.0, 0.0, -1.0])
RAYS = {camera: pixel_rays(camera) for camera in (STRAIGHT, BARREL, PINCUSHION)}

cameras = st.sampled_from([STRAIGHT, BARREL, PINCUSHION])
attitudes = st.tuples(st.floats(-0.7, 0.7), st.floats(-0.6, 0.6), st.floats(-3.1, 3.1))


def centroid(image: np.ndarray) -> np.ndarray:
    """Return the brightness-weighted centre in pixels from the image's corner."""
    weight = image.astype(float).sum(axis=2)
    rows, columns = np.mgrid[: weight.shape[0], : weight.shape[1]]
    total = weight.sum()
    return np.array([((columns + 0.5) * weight).sum(), ((rows + 0.5) * weight).sum()]) / total


def painted(camera: CameraModel, solids: list[Solid], view: CameraView) -> np.ndarray:
    image = np.zeros((camera.height, camera.width, 3), np.uint8)
    painter = SolidPainter(LensProjection(camera))
    painter.paint(image, painter.select([SolidBatch.of(solids)], view), view)
    return image


@pytest.mark.slow
@settings(max_examples=60)
@given(cameras, attitudes, st.floats(40, 280), st.floats(40, 200), st.floats(6, 40))
def test_a_small_ball_is_drawn_at_its_projection(
    camera: CameraModel,
    attitude: tuple[float, float, float],
    column: float,
    row: float,
    distance: float,
) -> None:
    view = CameraView.of(BodyState(0, (3.0, -4.0, -9.0), attitude_rad=attitude), MOUNT)
    ray = camera.rays([[column, row]])[0]
    place = view.position_m + view.world_to_camera.T @ ray * distance
    mesh = ball(0.012 * distance, (0, 0, 0), (200, 200, 200))
    image = painted(camera, [Solid.placed(mesh, place, np.eye(3), UP)], view)
    image[image > 0] = 255
    assert np.linalg.norm(centroid(image) - (column, row)) < 0.5


corners = st.lists(
    st.tuples(st.integers(-16 * 80, 16 * 400), st.integers(-16 * 80, 16 * 320)),
    min_size=4,
    max_size=4,
)


@pytest.mark.slow
@settings(max_examples=300)
@given(corners)
def test_a_face_that_is_left_out_would_colour_nothing(face: list[tuple[int, int]]) -> None:
    polygon = cv2.convexHull(np.array(face, np.int32))
    image = np.zeros((STRAIGHT.height, STRAIGHT.width), np.uint8)
    cv2.fillConvexPoly(image, polygon, (255,), cv2.LINE_AA, 4)
    (in_image,) = SolidPainter(LensProjection(STRAIGHT)).in_image(np.array([face], np.int32))
    assert in_image or not image.any()


@pytest.mark.slow
@settings(max_examples=40)
@given(cameras, attitudes, st.floats(30, 290), st.floats(30, 210), st.floats(3, 30))
def test_a_mark_on_the_ground_is_drawn_at_its_projection(
    camera: CameraModel,
    attitude: tuple[float, float, float],
    column: float,
    row: float,
    height: float,
) -> None:
    view = CameraView.of(BodyState(0, (20.0, 35.0, -height), attitude_rad=attitude), MOUNT)
    ray = view.world_to_camera.T @ camera.rays([[column, row]])[0]
    assume(ray[2] > 0.3)
    place = view.position_m + ray * height / ray[2]
    m_per_px = 0.002 * float(np.linalg.norm(place - view.position_m))
    image = np.zeros((600, 600, 3), np.uint8)
    cv2.circle(image, (4800, 4800), 7 * 16, (255, 255, 255), -1, cv2.LINE_AA, 4)
    half = 300.5 * m_per_px
    ground = GroundMap(image, float(place[0] + half), float(place[1] - half), m_per_px)
    empty = GroundMap(np.zeros((600, 600, 3), np.uint8), 3000.0, -3000.0, 10.0)
    drawn = np.zeros((camera.height, camera.width, 3), np.uint8)
    both = Ground(GroundPyramid([ground]), GroundPyramid([empty]))
    painter = GroundPainter(both, RAYS[camera], (0, 0, 0), 1e6)
    painter.paint(drawn, view)
    assume(drawn.any())
    assert np.linalg.norm(centroid(drawn) - (column, row)) < 1.0


@settings(max_examples=40)
@given(cameras, attitudes)
def test_the_ground_ends_at_the_horizon(
    camera: CameraModel, attitude: tuple[float, float, float]
) -> None:
    view = CameraView.of(BodyState(0, (0.0, 0.0, -8.0), attitude_rad=attitude), MOUNT)
    white = GroundMap(np.full((60, 60, 3), 255, np.uint8), 30000.0, -30000.0, 1000.0)
    drawn = np.zeros((camera.height, camera.width, 3), np.uint8)
    both = Ground(GroundPyramid([white]), GroundPyramid([white]))
    GroundPainter(both, RAYS[camera], (255, 255, 255), 1e9).paint(drawn, view)
    sink = RAYS[camera].component(view.world_to_camera[:, 2])
    assert not drawn[sink < 0].any()
    assert drawn[sink > 0.01].all()


def test_pixels_that_look_exactly_along_the_horizon_see_no_ground_and_do_no_harm() -> None:
    rows, columns = (
        np.float32(0.05) * axis for axis in np.mgrid[-24:24, -32:32].astype(np.float32)
    )
    white = GroundPyramid([GroundMap(np.full((60, 60, 3), 255, np.uint8), 30.0, -30.0, 1.0)])
    drawn = np.zeros((48, 64, 3), np.uint8)
    painter = GroundPainter(Ground(white, white), PixelRays(columns, rows, 20.0), (0, 0, 0), 1e9)
    painter.paint(drawn, CameraView(np.array([0.0, 0.0, -5.0]), LEVEL))
    assert not drawn[:25].any()
    assert drawn[25:].all()


@pytest.mark.parametrize("yaw_deg", [0, 90, 180, 270])
def test_east_is_to_the_right_when_looking_north(yaw_deg: float) -> None:
    yaw = math.radians(yaw_deg)
    body = BodyState(0, (0.0, 0.0, -5.0), attitude_rad=(0.0, 0.0, yaw))
    ahead_right = np.array(
        [10 * math.cos(yaw) - 3 * math.sin(yaw), 10 * math.sin(yaw) + 3 * math.cos(yaw), -5.0]
    )
    mesh = ball(0.3, (0, 0, 0), (200, 200, 200))
    view = CameraView.of(body, CameraMount())
    image = painted(STRAIGHT, [Solid.placed(mesh, ahead_right, np.eye(3), UP)], view)
    image[image > 0] = 255
    x, y = centroid(image)
    assert x == pytest.approx(160 + STRAIGHT.fx * 0.3, abs=0.5)
    assert y == pytest.approx(120, abs=0.5)


def test_nearer_bodies_hide_farther_ones() -> None:
    view = CameraView.of(BodyState(0, (0.0, 0.0, -1.0)), CameraMount())
    near = Solid.placed(box((1, 4, 4), (0, 0, 255), (0, 0, -1)), (10, 0, 0), np.eye(3), UP)
    far = Solid.placed(box((1, 4, 4), (0, 255, 0), (0, 0, -1)), (15, 0, 0), np.eye(3), UP)
    for order in ([near, far], [far, near]):
        assert painted(STRAIGHT, order, view)[120, 160, 2] > 100


@pytest.mark.parametrize("camera", [STRAIGHT, BARREL])
def test_a_wall_that_reaches_behind_the_camera_fills_its_side_of_the_image(
    camera: CameraModel,
) -> None:
    view = CameraView.of(BodyState(0, (0.0, 0.0, -1.0)), CameraMount())
    wall = Solid.placed(box((60, 1, 40), (90, 90, 90), (0, 0, -20)), (0, 2.5, 0), np.eye(3), UP)
    image = painted(camera, [wall], view)
    edge = camera.pixels([[2, 0, 29.99]])[0, 0]
    assert image[:, int(edge) + 4 :].all()
    assert not image[:, : int(edge) - 4].any()


@settings(max_examples=60)
@given(cameras, attitudes, st.floats(-30, 30), st.floats(-30, 30), st.floats(-15, 2))
def test_a_body_anywhere_is_drawn_within_its_projected_outline(
    camera: CameraModel,
    attitude: tuple[float, float, float],
    north: float,
    east: float,
    down: float,
) -> None:
    view = CameraView.of(BodyState(0, (0.0, 0.0, -6.0), attitude_rad=attitude), MOUNT)
    body = Solid.placed(box((4, 2, 1.5), (230, 230, 230)), (north, east, down), np.eye(3), UP)
    corners = view.to_camera(body.vertices)
    image = painted(camera, [body], view)
    if (corners[:, 2] < 0).all():
        assert not image.any()
    elif (corners[:, 2] > 0.5).all() and not LensProjection(camera).outside(corners).any():
        rows, columns = np.nonzero(image[..., 0] > 115)
        hull = camera.pixels(corners)
        if len(rows):
            assert columns.min() >= hull[:, 0].min() - 2
            assert columns.max() <= hull[:, 0].max() + 1
            assert rows.min() >= hull[:, 1].min() - 2
            assert rows.max() <= hull[:, 1].max() + 1


def test_the_lens_never_folds_points_from_outside_into_the_image() -> None:
    camera = CameraModel.from_fov(320, 240, math.radians(60), (-0.25, 0.0, 0.0, 0.0, 0.0))
    view = CameraView.of(BodyState(0, (0.0, 0.0, -1.0)), CameraMount())
    for right in np.linspace(6, 60, 30):
        aside = Solid.placed(box((1, 1, 1), (90, 90, 90)), (5, right, 0), np.eye(3), UP)
        assert not painted(camera, [aside], view).any()
