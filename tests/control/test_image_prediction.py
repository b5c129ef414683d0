"""Where a target can be becomes a region of the image, and shrinks or grows as physics says."""

import math
from itertools import pairwise

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import assume, example, given

from follower_control.servo.servo import VisualServo
from follower_control.servo.settings import ServoSettings
from follower_control.target.estimator import TargetEstimator
from follower_control.target.image_prediction import PredictedRegion, prospect
from follower_control.target.observation import BearingFrame, BearingObservation, BearingObserver
from follower_control.target.settings import EstimatorSettings
from follower_control.target.world_filter import TargetWorldFilter, place_noise
from follower_control.vehicle.gimbal import GimbalHistory
from follower_control.vehicle.history import AttitudeHistory
from follower_control.vehicle.setpoint import HOLD
from follower_control.vehicle.state import Attitude, GimbalState, LocalPosition, VehicleState
from follower_vision.geometry.box import Box, lies_in
from follower_vision.geometry.camera_model import CameraModel, Vector
from follower_vision.geometry.line_of_sight import CameraMount, LineOfSight
from follower_vision.trackers.track import Track, TrackState

LENS = CameraModel.from_fov(640, 480, math.radians(80), (-0.06, 0.01, 0.0, 0.0, 0.0))
OBSERVER = BearingObserver(LENS, CameraMount(pitch_rad=math.radians(-15)), latency_s=0.1)

HERE = np.zeros(3)


def known(roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> AttitudeHistory:
    history = AttitudeHistory()
    history.add(Attitude(roll, pitch, yaw, 0, 0, 0, 9.9))
    return history


def image_of(
    away_m: Vector, attitudes: AttitudeHistory, gimbal: GimbalHistory | None = None
) -> Vector:
    """Where in the image of a camera that is turned so places are."""
    return OBSERVER.view(10.0, HERE, attitudes, gimbal).pixels(away_m)


@given(
    x=st.floats(20, 620),
    y=st.floats(20, 460),
    roll=st.floats(-0.5, 0.5),
    pitch=st.floats(-0.4, 0.4),
    yaw=st.floats(-3, 3),
    distance_m=st.floats(1, 200),
)
def test_what_was_sighted_at_a_pixel_is_expected_there(x, y, roll, pitch, yaw, distance_m):
    attitudes = known(roll, pitch, yaw)
    track = Track(Box(x, y, 8, 8), TrackState.TRACKING, 1.0, "test", 10.0, 0)
    observed = OBSERVER.observe(track, attitudes)
    place = distance_m * observed.line_of_sight.vector
    np.testing.assert_allclose(image_of(place[None], attitudes), [[x, y]], atol=1e-3)


def test_a_gimbal_s_camera_counts_where_there_is_one():
    gimbal = GimbalHistory()
    level = Attitude(0, math.radians(-40), 0.5, 0, 0, 0, 9.9)
    gimbal.add(GimbalState(level, is_level=True, from_north=True))
    away = 10 * np.array([[math.cos(0.5), math.sin(0.5), math.tan(math.radians(40))]])
    seen = image_of(away, known(roll=0.3, pitch=-0.2, yaw=2.0), gimbal)
    np.testing.assert_allclose(seen, [[320, 240]], atol=1.0)
    assert OBSERVER.view(10.0, HERE, known(), GimbalHistory()) is None


def test_without_an_attitude_nothing_is_foreseen():
    assert (
        prospect(PredictedRegion(np.array([10.0, 0, 3]), 1, 2), OBSERVER, 10.0, AttitudeHistory())
        is None
    )


@given(
    ahead=st.floats(4, 60),
    right=st.floats(-15, 15),
    down=st.floats(-3, 15),
    reach=st.floats(0, 10),
    angle=st.floats(-math.pi, math.pi),
    share=st.floats(0, 1),
)
def test_wherever_it_can_have_gone_is_in_the_region(ahead, right, down, reach, angle, share):
    """Whatever way a target on the ground took, its image is where it can be."""
    outlook = PredictedRegion(np.array([ahead, right, down]), reach / 2, reach)
    seen = prospect(outlook, OBSERVER, 10.0, known())
    gone = outlook.away_m + share * reach * np.array([math.cos(angle), math.sin(angle), 0.0])
    assume(gone[0] > 0.5 * np.linalg.norm(gone))
    assume(np.hypot(*gone[:2]) > 0.5 * np.hypot(ahead, right))
    (x, y), *_ = image_of(gone[None], known()).tolist()
    # What lies crosswise reaches further than along or across alone, at the corners of the region.
    assert lies_in(Box(x, y, 1, 1), seen.possible, 0.05 * LENS.fx)


@given(likely=st.floats(0, 5), more=st.floats(0, 10), ahead=st.floats(5, 40))
def test_what_is_likely_is_possible(likely, more, ahead):
    seen = prospect(
        PredictedRegion(np.array([ahead, 2, 5]), likely, likely + more), OBSERVER, 10.0, known()
    )
    assert lies_in(Box(seen.cx, seen.cy, 1, 1), seen.likely)
    # Farther than an image's side outside of it straight lines mean nothing any more.
    size = np.array([LENS.width, LENS.height])
    likely, possible = (
        np.clip([[one.left, one.top], [one.right, one.bottom]], -size, 2 * size)
        for one in (seen.likely, seen.possible)
    )
    assert np.all(possible[0] <= likely[0] + 1e-6)
    assert np.all(possible[1] >= likely[1] - 1e-6)


@pytest.mark.parametrize("ahead", [0.0, -12.0])
def test_a_target_that_left_to_the_right_is_expected_right_of_the_image(ahead):
    seen = prospect(PredictedRegion(np.array([ahead, 12.0, 4]), 1, 2), OBSERVER, 10.0, known())
    assert seen.possible.left > LENS.width
    assert math.isfinite(seen.cx)
    assert math.isfinite(seen.cy)


@pytest.mark.parametrize("late_s", [-0.05, 0.05])
def test_a_camera_that_is_a_little_later_than_said_loses_no_target_in_a_turn(late_s):
    """The attitude is then another than the one with which the region was made."""
    turn = math.radians(60)
    said, true = AttitudeHistory(), AttitudeHistory()
    said.add(Attitude(0, 0, 0.0, 0, 0, turn, 9.9))
    true.add(Attitude(0, 0, turn * late_s, 0, 0, turn, 9.9))
    away = np.array([14.0, 1.0, 5.0])
    seen = prospect(PredictedRegion(away, 0.0, 0.0), OBSERVER, 10.0, said)
    (x, y), *_ = image_of(away[None], true).tolist()
    assert lies_in(Box(x, y, 1, 1), seen.likely, 1.0)
    still = prospect(PredictedRegion(away, 0.0, 0.0), OBSERVER, 10.0, known())
    assert not lies_in(Box(x, y, 1, 1), still.likely, 1.0)


def test_a_target_right_below_is_expected_below_the_image():
    seen = prospect(PredictedRegion(np.array([0.0, 0.0, 8.0]), 1, 2), OBSERVER, 10.0, known())
    assert seen.cy > LENS.height


@given(
    away=st.lists(st.floats(-1e4, 1e4), min_size=3, max_size=3),
    likely=st.floats(0, 1e3),
    more=st.floats(0, 1e4),
    yaw=st.floats(-4, 4),
)
@example(away=[0.0, 0.0, 0.0], likely=0.0, more=0.0, yaw=0.0)
def test_wherever_it_is_the_region_is_finite_and_around_it(away, likely, more, yaw):
    seen = prospect(
        PredictedRegion(np.array(away), likely, likely + more), OBSERVER, 10.0, known(yaw=yaw)
    )
    assert all(map(math.isfinite, (seen.cx, seen.cy, *seen.likely.xywh, *seen.possible.xywh)))
    assert lies_in(Box(seen.cx, seen.cy, 1, 1), seen.likely, 1e-3)


def test_the_reach_grows_by_what_a_manoeuvre_makes_of_the_time():
    target = TargetWorldFilter(1.0)
    noise = place_noise(np.array([1.0, 0, 0]), 0.4, 0.1)
    for number in range(60):
        target.observe(np.array([15.0, 0.1 * number, 0]), noise, number / 30)
    last_s = 59 / 30
    assert target.reach_m(last_s, 0, 3.0) == 0
    for after_s in (0.5, 1.0, 2.0):
        assert target.reach_m(last_s + after_s, 0, 3.0) == pytest.approx(3.0 * after_s**2 / 2)
        seen_m = target.reach_m(last_s + after_s, 1, 0)
        assert target.reach_m(last_s + after_s, 3, 3.0) == pytest.approx(
            3 * seen_m + 3.0 * after_s**2 / 2
        )
    spread = [target.reach_m(last_s + after_s, 1, 0) for after_s in (0, 0.5, 1, 2)]
    assert spread == sorted(spread)
    assert 0.05 < spread[0] < 0.4


def _walked(ways: list[tuple[float, np.ndarray]]) -> TargetWorldFilter:
    """Return a target that was seen at 20 Hz, going for so long with each velocity in turn."""
    target, place, time_s = TargetWorldFilter(1.0), np.array([15.0, 0.0, 0.0]), 0.0
    noise = place_noise(np.array([1.0, 0, 0]), 0.2, 0.1)
    for duration_s, velocity in ways:
        for _ in range(round(duration_s / 0.05)):
            target.observe(place, noise, time_s)
            place, time_s = place + 0.05 * velocity, time_s + 0.05
    return target


NORTH, EAST = np.array([3.0, 0, 0]), np.array([0, 3.0, 0])


def test_what_was_believed_before_a_look_alike_was_followed_foretells_the_target():
    target = _walked([(3.0, NORTH), (1.0, EAST)])
    true = np.array([15.0, 0, 0]) + 4.0 * NORTH
    now, _ = target.at(4.0)
    assert np.linalg.norm(now - true) > 3.5
    before = [one for one in target.earlier() if 0.5 < one.time_s <= 3.0]
    assert len(before) >= 4
    for one in before:
        assert np.linalg.norm(one.at(4.0)[0] - true) < 0.5


def test_it_is_remembered_every_now_and_then_for_four_seconds_and_asking_changes_nothing():
    target = _walked([(8.0, NORTH)])
    before = target.at(9.0)[0], target.reach_m(9.0, 1, 2)
    times = [one.time_s for one in target.earlier()]
    assert times == sorted(times, reverse=True)
    assert all(near - far >= 0.4 - 1e-9 for near, far in pairwise(times))
    assert 3.4 <= target.time_s - times[-1] <= 4.5
    np.testing.assert_array_equal(target.at(9.0)[0], before[0])
    assert target.reach_m(9.0, 1, 2) == before[1]
    target.reset()
    assert list(target.earlier()) == []


def test_a_forecast_is_where_its_place_is_seen_and_dated_by_the_frames_clock():
    earlier = [
        PredictedRegion(np.array([14.0, share, 4.0]), 1.0, 3.0, 8.5, 1.2) for share in (-4.0, 3.0)
    ]
    now = PredictedRegion(np.array([14.0, 0.0, 4.0]), 0.5, 1.0)
    seen = prospect(now, OBSERVER, 10.0, known(), earlier=earlier)
    alone = prospect(now, OBSERVER, 10.0, known())
    assert (seen.cx, seen.cy, seen.likely, seen.possible) == (
        alone.cx,
        alone.cy,
        alone.likely,
        alone.possible,
    )
    places = image_of(np.array([one.away_m for one in earlier]), known())
    for one, (x, y) in zip(seen.earlier, places.tolist(), strict=True):
        assert (one.cx, one.cy) == pytest.approx((x, y))
        assert lies_in(Box(x, y, 1, 1), one.likely)
        # The camera is 0.1 s late: what was exposed at 8.5 s has the time stamp 8.6 s.
        assert one.since_s == pytest.approx(8.6)
        assert one.nearer == 1.2


def test_a_target_that_is_flown_up_to_looks_nearer_than_before():
    servo = VisualServo(ServoSettings(target_size_m=1.0, distance_m=10.0))
    estimator = TargetEstimator(EstimatorSettings())
    servo.start()
    for number in range(200):
        now_s = 0.02 * number
        north_m = 2.5 * now_s
        away = np.array([25.0 - north_m, 0.0, 5.0])
        range_m = float(np.linalg.norm(away))
        sight = LineOfSight(0.0, -math.asin(5.0 / range_m))
        world = BearingFrame.WORLD
        estimator.observe(BearingObservation(sight, math.log(1.0 / range_m), now_s, world, False))
        attitude = Attitude(0, 0, 0, 0, 0, 0, now_s)
        position = LocalPosition(north_m, 0, -5, 2.5, 0, 0, now_s)
        estimate = estimator.estimate(now_s)
        servo.update(estimate, VehicleState(attitude, position, "OFFBOARD", True, True), HOLD)
    then = servo.pursuit.earlier_predictions(now_s)
    assert len(then) >= 5
    for one in then:
        was_m = math.hypot(25.0 - 2.5 * one.seen_s, 5.0)
        assert one.nearer == pytest.approx(was_m / range_m, rel=0.05)
        np.testing.assert_allclose(one.away_m[:2], away[:2], atol=1.5)
