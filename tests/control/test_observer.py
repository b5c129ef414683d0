"""A box in an image becomes a direction in the world, whatever the vehicle's attitude."""

import math

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import assume, given

from follower_control.target.observation import BearingFrame, BearingObserver
from follower_control.vehicle.history import AttitudeHistory
from follower_control.vehicle.state import Attitude
from follower_vision.geometry.box import Box
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.geometry.line_of_sight import CameraMount, LineOfSight, rotation
from follower_vision.trackers.track import Track, TrackState

CAMERA = CameraModel.from_fov(640, 480, math.radians(70))
DISTORTED = CameraModel.from_fov(640, 480, math.radians(70), (-0.25, 0.07, 0.001, -0.001, 0.0))
DOWN_20 = CameraMount(pitch_rad=math.radians(-20))


def track(box: Box, captured_s: float = 10.0) -> Track:
    return Track(box, TrackState.TRACKING, 1.0, "test", captured_s, 0)


def known(roll=0.0, pitch=0.0, yaw=0.0, time_s=10.0) -> AttitudeHistory:
    history = AttitudeHistory()
    history.add(Attitude(roll, pitch, yaw, 0, 0, 0, time_s))
    return history


def test_right_of_the_centre_is_positive_azimuth_and_above_is_positive_elevation():
    observed = BearingObserver(CAMERA, CameraMount()).observe(track(Box(420, 100, 30, 30)), known())
    assert observed.line_of_sight.azimuth_rad > 0.1
    assert observed.line_of_sight.elevation_rad > 0.1


@pytest.mark.parametrize(
    ("history", "frame", "azimuth_rad"),
    [(known(yaw=2.0), BearingFrame.WORLD, 2.0), (AttitudeHistory(), BearingFrame.BODY, 0.0)],
    ids=["heading is added", "without telemetry it is the body's"],
)
def test_the_mount_s_pitch_lowers_the_centre(history, frame, azimuth_rad):
    observed = BearingObserver(CAMERA, DOWN_20).observe(track(Box(320, 240, 30, 30)), history)
    assert observed.frame is frame
    assert observed.line_of_sight.azimuth_rad == pytest.approx(azimuth_rad)
    assert observed.line_of_sight.elevation_rad == pytest.approx(math.radians(-20))


@given(
    azimuth=st.floats(-math.pi, math.pi),
    elevation=st.floats(-0.5, -0.2),
    roll=st.floats(-0.5, 0.5),
    pitch=st.floats(-0.25, 0.25),
    off=st.floats(-0.3, 0.3),
)
def test_tilting_does_not_move_a_target_in_the_world(azimuth, elevation, roll, pitch, off):
    target = LineOfSight(azimuth, elevation)
    turn = rotation(roll, pitch, azimuth + off) @ DOWN_20.camera_to_body
    (x, y), *_ = DISTORTED.pixels([turn.T @ target.vector])
    assume(30 < x < 610 and 30 < y < 450)
    history = known(roll, pitch, azimuth + off)
    observed = BearingObserver(DISTORTED, DOWN_20).observe(track(Box(x, y, 8, 8)), history)
    np.testing.assert_allclose(observed.line_of_sight.vector, target.vector, atol=1e-6)


def test_the_attitude_is_the_one_at_the_exposure_not_the_present_one():
    history = AttitudeHistory()
    for i in range(50):
        history.add(Attitude(0, 0, 0.02 * i, 0, 0, 1.0, 0.02 * i))
    observed = BearingObserver(CAMERA, CameraMount(), latency_s=0.1).observe(
        track(Box(320, 240, 20, 20), captured_s=0.5), history
    )
    assert observed.time_s == pytest.approx(0.4)
    assert observed.line_of_sight.azimuth_rad == pytest.approx(0.4)


@pytest.mark.parametrize("time_s", [5.0, 15.0])
def test_with_telemetry_but_no_attitude_for_that_time_there_is_no_sighting(time_s):
    box = Box(320, 240, 20, 20)
    assert BearingObserver(CAMERA, DOWN_20).observe(track(box), known(time_s=time_s)) is None


@pytest.mark.parametrize("camera", [CAMERA, DISTORTED], ids=["pinhole", "distorted"])
@given(azimuth=st.floats(-0.45, 0.45), elevation=st.floats(-0.3, 0.3), size=st.floats(0.01, 0.1))
def test_the_scale_is_the_angle_wherever_in_the_image(camera, azimuth, elevation, size):
    """Project the middles of the edges of a patch of the sphere, and read the angle back."""

    def pixel(across: float, up: float):
        # A small turn about the camera's own axes, so that the patch is square where it is seen.
        centre = LineOfSight(azimuth, elevation).vector
        right = LineOfSight(azimuth + math.pi / 2, 0).vector
        above = LineOfSight(azimuth, elevation + math.pi / 2).vector
        point = centre + right * math.tan(across) + above * math.tan(up)
        return camera.pixels([CameraMount().camera_to_body.T @ point])[0]

    half = size / 2
    left, right = pixel(-half, 0), pixel(half, 0)
    top, bottom = pixel(0, half), pixel(0, -half)
    box = Box.from_xywh(left[0], top[1], right[0] - left[0], bottom[1] - top[1])
    observed = BearingObserver(camera, CameraMount()).observe(track(box), AttitudeHistory())
    assert math.exp(observed.log_scale) == pytest.approx(size, rel=0.06)


def test_half_the_distance_is_log_two_more_scale():
    observer = BearingObserver(CAMERA, CameraMount())
    near = observer.observe(track(Box(320, 240, 40, 20)), AttitudeHistory())
    far = observer.observe(track(Box(320, 240, 20, 10)), AttitudeHistory())
    assert near.log_scale - far.log_scale == pytest.approx(math.log(2), abs=0.002)


@pytest.mark.parametrize(
    ("box", "is_cut"),
    [
        (Box(320, 240, 40, 40), False),
        (Box(10, 240, 40, 40), True),
        (Box(630, 240, 40, 40), True),
        (Box(320, 5, 40, 40), True),
        (Box(320, 470, 40, 40), True),
    ],
    ids=["inside", "left", "right", "top", "bottom"],
)
def test_a_box_over_the_border_is_marked(box, is_cut):
    assert BearingObserver(CAMERA, CameraMount()).observe(track(box), known()).is_cut is is_cut


def test_a_time_that_is_not_finite_gives_no_sighting():
    box = Box(320, 240, 20, 20)
    assert (
        BearingObserver(CAMERA, CameraMount()).observe(track(box, math.nan), AttitudeHistory())
        is None
    )


def test_a_latency_that_is_not_finite_is_refused():
    with pytest.raises(ValueError, match="latency"):
        BearingObserver(CAMERA, CameraMount(), math.nan)
