"""Pixels, rays and directions: round trips and signs, for any camera."""

import math

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from follower_vision.geometry.box import Box
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.geometry.line_of_sight import (
    CameraMount,
    LineOfSight,
    along_camera_axes,
    rotation,
    wrap_angle,
)

WIDTH, HEIGHT = 640, 480
fields_of_view = st.floats(math.radians(20), math.radians(110))
# Stronger barrels fold the corners over: no ray is seen there.
mild = st.tuples(
    st.floats(-0.1, 0.2),
    st.floats(-0.01, 0.03),
    st.floats(-0.002, 0.002),
    st.floats(-0.002, 0.002),
    st.just(0.0),
)
inside = st.tuples(st.floats(0, WIDTH), st.floats(0, HEIGHT))
angles = st.floats(-math.pi, math.pi)
sizes = st.floats(0.5, 500)
places = st.floats(-1000, 1000)
boxes = st.builds(Box, places, places, sizes, sizes)


@given(fields_of_view, inside)
def test_a_pinhole_projects_its_rays_back_to_their_pixels(fov, pixel):
    camera = CameraModel.from_fov(WIDTH, HEIGHT, fov)
    np.testing.assert_allclose(camera.pixels(camera.rays([pixel]))[0], pixel, atol=1e-8)


@given(st.floats(math.radians(30), math.radians(75)), mild, inside)
def test_a_distorted_camera_does_so_too(fov, distortion, pixel):
    camera = CameraModel.from_fov(WIDTH, HEIGHT, fov, distortion)
    np.testing.assert_allclose(camera.pixels(camera.rays([pixel]))[0], pixel, atol=1e-3)


@given(fields_of_view, inside)
def test_rays_are_unit_vectors_that_look_forward(fov, pixel):
    ray = CameraModel.from_fov(WIDTH, HEIGHT, fov).rays([pixel])[0]
    assert np.linalg.norm(ray) == pytest.approx(1)
    assert ray[2] > 0


@given(fields_of_view)
def test_the_image_s_side_edges_span_the_field_of_view(fov):
    camera = CameraModel.from_fov(WIDTH, HEIGHT, fov)
    left, right = camera.rays([(0, HEIGHT / 2), (WIDTH, HEIGHT / 2)])
    assert math.acos(np.clip(left @ right, -1, 1)) == pytest.approx(fov, abs=1e-6)
    assert camera.horizontal_fov_rad == pytest.approx(fov)


@given(fields_of_view, mild, inside, st.floats(0.2, 4))
def test_resizing_an_image_does_not_move_what_is_seen(fov, distortion, pixel, factor):
    camera = CameraModel.from_fov(WIDTH, HEIGHT, fov, distortion)
    across, down = round(WIDTH * factor), round(HEIGHT * factor)
    small = camera.resized(across, down)
    moved = (pixel[0] * across / WIDTH, pixel[1] * down / HEIGHT)
    np.testing.assert_allclose(small.rays([moved]), camera.rays([pixel]), atol=1e-9)


def test_barrel_distortion_draws_points_to_the_centre():
    straight = CameraModel.from_fov(WIDTH, HEIGHT, 1.2)
    barrel = CameraModel.from_fov(WIDTH, HEIGHT, 1.2, (-0.2, 0, 0, 0, 0))
    point = [(0.3, 0.2, 1.0)]
    centre = np.array([WIDTH / 2, HEIGHT / 2])
    far = np.linalg.norm(straight.pixels(point)[0] - centre)
    assert np.linalg.norm(barrel.pixels(point)[0] - centre) < far


@pytest.mark.parametrize("depth", [0.0, -1.0])
def test_what_is_behind_the_camera_has_no_image(depth):
    camera = CameraModel.from_fov(WIDTH, HEIGHT, 1.2)
    assert np.isnan(camera.pixels([(0.1, 0.1, depth)])).all()


def direction(pixel, mount=None) -> LineOfSight:
    camera = CameraModel.from_fov(WIDTH, HEIGHT, math.radians(70))
    return LineOfSight.from_vector(
        (mount or CameraMount()).camera_to_body @ camera.rays([pixel])[0]
    )


@given(st.floats(1, 300), st.floats(1, 220))
def test_right_is_positive_azimuth_and_up_is_positive_elevation(right, up):
    seen = direction((WIDTH / 2 + right, HEIGHT / 2 - up))
    assert seen.azimuth_rad > 0
    assert seen.elevation_rad > 0
    mirrored = direction((WIDTH / 2 - right, HEIGHT / 2 + up))
    assert mirrored.azimuth_rad == pytest.approx(-seen.azimuth_rad)
    assert mirrored.elevation_rad == pytest.approx(-seen.elevation_rad)


@given(st.floats(-80, 80))
def test_the_mount_s_pitch_is_the_elevation_of_the_centre(pitch_deg):
    mount = CameraMount(pitch_rad=math.radians(pitch_deg))
    seen = direction((WIDTH / 2, HEIGHT / 2), mount)
    assert math.degrees(seen.elevation_rad) == pytest.approx(pitch_deg)


def test_the_mount_s_yaw_is_the_azimuth_of_the_centre():
    seen = direction((WIDTH / 2, HEIGHT / 2), CameraMount(yaw_rad=0.7))
    assert (seen.azimuth_rad, seen.elevation_rad) == pytest.approx((0.7, 0.0))


def test_a_camera_rolled_clockwise_sees_what_is_on_the_right_of_its_image_lower():
    rolled = CameraMount(roll_rad=math.radians(30))
    assert direction((WIDTH, HEIGHT / 2), rolled).elevation_rad < -0.1


@given(angles, st.floats(-1.5, 1.5))
def test_directions_and_vectors_are_the_same(azimuth, elevation):
    vector = LineOfSight(azimuth, elevation).vector
    assert np.linalg.norm(vector) == pytest.approx(1)
    again = LineOfSight.from_vector(7.5 * vector)
    assert wrap_angle(again.azimuth_rad - azimuth) == pytest.approx(0, abs=1e-9)
    assert again.elevation_rad == pytest.approx(elevation, abs=1e-9)


@given(angles, angles, angles)
def test_rotations_keep_lengths_and_handedness(roll, pitch, yaw):
    matrix = rotation(roll, pitch, yaw)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1)


@given(angles, angles, angles)
def test_rotations_come_in_the_order_yaw_pitch_roll(roll, pitch, yaw):
    expected = rotation(0, 0, yaw) @ rotation(0, pitch, 0) @ rotation(roll, 0, 0)
    np.testing.assert_allclose(rotation(roll, pitch, yaw), expected, atol=1e-12)


def test_each_rotation_has_the_sign_of_its_name():
    forward, right, down = np.eye(3)
    quarter = math.pi / 2
    np.testing.assert_allclose(rotation(0, 0, quarter) @ forward, right, atol=1e-12)
    np.testing.assert_allclose(rotation(0, quarter, 0) @ forward, -down, atol=1e-12)
    np.testing.assert_allclose(rotation(quarter, 0, 0) @ right, down, atol=1e-12)


def test_camera_axes_are_body_axes_in_another_order():
    camera_right, camera_down, camera_forward = np.eye(3)
    to_body = along_camera_axes(np.eye(3))
    np.testing.assert_array_equal(to_body @ camera_forward, [1, 0, 0])
    np.testing.assert_array_equal(to_body @ camera_right, [0, 1, 0])
    np.testing.assert_array_equal(to_body @ camera_down, [0, 0, 1])


@given(st.floats(-100, 100))
def test_wrapping_keeps_the_direction(angle):
    wrapped = wrap_angle(angle)
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


@pytest.mark.parametrize("fov", [0.0, math.pi, -1.0, math.nan])
def test_an_impossible_field_of_view_is_refused(fov):
    with pytest.raises(ValueError, match="field of view"):
        CameraModel.from_fov(WIDTH, HEIGHT, fov)


@pytest.mark.parametrize("bad", [{"fx": 0.0}, {"cx": math.nan}, {"width": -1}])
def test_impossible_intrinsics_are_refused(bad):
    good = {"width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0}
    with pytest.raises(ValueError, match="camera needs"):
        CameraModel(**(good | bad))


@given(boxes, boxes)
def test_overlap_is_symmetric_and_a_share(a, b):
    assert a.iou(b) == pytest.approx(b.iou(a))
    assert 0 <= a.iou(b) <= 1 + 1e-9
    assert a.intersection(b) <= min(a.area, b.area) * (1 + 1e-9)


@given(boxes)
def test_a_box_overlaps_itself_wholly_and_survives_its_corner_form(box):
    assert box.iou(box) == pytest.approx(1)
    assert Box.from_xywh(*box.xywh).iou(box) == pytest.approx(1)
    assert box.scale**2 == pytest.approx(box.area)


@given(boxes, places, places, st.floats(0.1, 10))
def test_moving_and_scaling_do_only_that(box, x, y, factor):
    moved = box.moved_to(x, y)
    assert (moved.cx, moved.cy, moved.width, moved.height) == (x, y, box.width, box.height)
    assert moved.distance(box) == pytest.approx(math.hypot(x - box.cx, y - box.cy))
    scaled = box.scaled(factor)
    assert scaled.area == pytest.approx(box.area * factor**2)
    assert (scaled.cx, scaled.cy) == (box.cx, box.cy)


@given(boxes)
def test_the_visible_share_is_all_inside_and_nothing_outside(box):
    share = box.visible_share(WIDTH, HEIGHT)
    assert 0 <= share <= 1 + 1e-9
    if box.left >= 0 and box.top >= 0 and box.right <= WIDTH and box.bottom <= HEIGHT:
        assert share == pytest.approx(1)
    if box.right <= 0 or box.left >= WIDTH or box.bottom <= 0 or box.top >= HEIGHT:
        assert share == 0


@given(boxes)
def test_what_is_clipped_is_the_common_part(box):
    inside, image = box.clipped(WIDTH, HEIGHT), Box(WIDTH / 2, HEIGHT / 2, WIDTH, HEIGHT)
    if inside is None:
        assert box.visible_share(WIDTH, HEIGHT) == pytest.approx(0, abs=1e-9)
        return
    assert inside.area == pytest.approx(box.intersection(image), rel=1e-6, abs=1e-6)
    assert inside.intersection(box) == pytest.approx(inside.area, rel=1e-6, abs=1e-6)
    if box.visible_share(WIDTH, HEIGHT) == 1:
        assert inside.iou(box) == pytest.approx(1)


@pytest.mark.parametrize("bad", [(0, 0, 0, 1), (0, 0, 1, -1), (math.nan, 0, 1, 1)])
def test_impossible_boxes_are_refused(bad):
    with pytest.raises(ValueError, match="box needs"):
        Box(*bad)


@given(fields_of_view, angles, st.floats(-0.8, 0.8), st.floats(-0.6, 0.3))
def test_a_direction_survives_the_way_through_the_camera(fov, yaw, off, elevation):
    camera = CameraModel.from_fov(WIDTH, HEIGHT, fov)
    turn = rotation(0.1, -0.2, yaw) @ CameraMount(pitch_rad=-0.3).camera_to_body
    target = LineOfSight(yaw + off, elevation)
    pixels = camera.pixels([turn.T @ target.vector])
    again = LineOfSight.from_vector(turn @ camera.rays(pixels)[0])
    np.testing.assert_allclose(again.vector, target.vector, atol=1e-9)
