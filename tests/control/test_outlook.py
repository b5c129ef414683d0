"""Where a target can be becomes a region of the image, and shrinks or grows as physics says."""

import math

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import assume, example, given

from follower_control.attitude_history import AttitudeHistory
from follower_control.gimbal_history import GimbalHistory
from follower_control.moving_target import MovingTarget, place_noise
from follower_control.outlook import Outlook, prospect
from follower_control.sighter import Sighter
from follower_control.vehicle import Attitude, GimbalState
from follower_vision.box import Box
from follower_vision.camera import CameraModel
from follower_vision.lineofsight import CameraMount
from follower_vision.prospect import has_middle
from follower_vision.track import Track, TrackState

LENS = CameraModel.from_fov(640, 480, math.radians(80), (-0.06, 0.01, 0.0, 0.0, 0.0))
SIGHTER = Sighter(LENS, CameraMount(pitch_rad=math.radians(-15)), latency_s=0.1)


def known(roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> AttitudeHistory:
    history = AttitudeHistory()
    history.add(Attitude(roll, pitch, yaw, 0, 0, 0, 9.9))
    return history


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
    sighting = SIGHTER.sight(track, attitudes)
    place = distance_m * sighting.line_of_sight.vector
    np.testing.assert_allclose(SIGHTER.image_of(place[None], 10.0, attitudes), [[x, y]], atol=1e-3)


def test_a_gimbal_s_camera_counts_where_there_is_one():
    gimbal = GimbalHistory()
    level = Attitude(0, math.radians(-40), 0.5, 0, 0, 0, 9.9)
    gimbal.add(GimbalState(level, is_level=True, from_north=True))
    away = 10 * np.array([[math.cos(0.5), math.sin(0.5), math.tan(math.radians(40))]])
    seen = SIGHTER.image_of(away, 10.0, known(roll=0.3, pitch=-0.2, yaw=2.0), gimbal)
    np.testing.assert_allclose(seen, [[320, 240]], atol=1.0)
    assert SIGHTER.image_of(away, 10.0, known(), GimbalHistory()) is None


def test_without_an_attitude_nothing_is_foreseen():
    assert prospect(Outlook(np.array([10.0, 0, 3]), 1, 2), SIGHTER, 10.0, AttitudeHistory()) is None


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
    outlook = Outlook(np.array([ahead, right, down]), reach / 2, reach)
    seen = prospect(outlook, SIGHTER, 10.0, known())
    gone = outlook.away_m + share * reach * np.array([math.cos(angle), math.sin(angle), 0.0])
    assume(gone[0] > 0.5 * np.linalg.norm(gone))
    assume(np.hypot(*gone[:2]) > 0.5 * np.hypot(ahead, right))
    (x, y), *_ = SIGHTER.image_of(gone[None], 10.0, known()).tolist()
    # What lies crosswise reaches further than along or across alone, at the corners of the region.
    assert has_middle(seen.possible, Box(x, y, 1, 1), 0.05 * LENS.fx)


@given(likely=st.floats(0, 5), more=st.floats(0, 10), ahead=st.floats(5, 40))
def test_what_is_likely_is_possible(likely, more, ahead):
    seen = prospect(Outlook(np.array([ahead, 2, 5]), likely, likely + more), SIGHTER, 10.0, known())
    assert has_middle(seen.likely, Box(seen.cx, seen.cy, 1, 1))
    assert seen.possible.left <= seen.likely.left + 1e-6
    assert seen.possible.right >= seen.likely.right - 1e-6
    assert seen.possible.top <= seen.likely.top + 1e-6
    assert seen.possible.bottom >= seen.likely.bottom - 1e-6


@pytest.mark.parametrize("ahead", [0.0, -12.0])
def test_a_target_that_left_to_the_right_is_expected_right_of_the_image(ahead):
    seen = prospect(Outlook(np.array([ahead, 12.0, 4]), 1, 2), SIGHTER, 10.0, known())
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
    seen = prospect(Outlook(away, 0.0, 0.0), SIGHTER, 10.0, said)
    (x, y), *_ = SIGHTER.image_of(away[None], 10.0, true).tolist()
    assert has_middle(seen.likely, Box(x, y, 1, 1), 1.0)
    still = prospect(Outlook(away, 0.0, 0.0), SIGHTER, 10.0, known())
    assert not has_middle(still.likely, Box(x, y, 1, 1), 1.0)


def test_a_target_right_below_is_expected_below_the_image():
    seen = prospect(Outlook(np.array([0.0, 0.0, 8.0]), 1, 2), SIGHTER, 10.0, known())
    assert seen.cy > LENS.height


@given(
    away=st.lists(st.floats(-1e4, 1e4), min_size=3, max_size=3),
    likely=st.floats(0, 1e3),
    more=st.floats(0, 1e4),
    yaw=st.floats(-4, 4),
)
@example(away=[0.0, 0.0, 0.0], likely=0.0, more=0.0, yaw=0.0)
def test_wherever_it_is_the_region_is_finite_and_around_it(away, likely, more, yaw):
    seen = prospect(Outlook(np.array(away), likely, likely + more), SIGHTER, 10.0, known(yaw=yaw))
    assert all(map(math.isfinite, (seen.cx, seen.cy, *seen.likely.xywh, *seen.possible.xywh)))
    assert has_middle(seen.likely, Box(seen.cx, seen.cy, 1, 1), 1e-3)


def test_the_reach_grows_by_what_a_manoeuvre_makes_of_the_time():
    target = MovingTarget(1.0)
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
