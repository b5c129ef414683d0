"""A gimbal in the line of sight: what its angles mean, and how it is turned after the target."""

import math

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from follower_control.servo.gimbal_servo import GimbalServo, GimbalSettings
from follower_control.target.estimate import TargetEstimate
from follower_control.target.observation import BearingFrame, BearingObserver
from follower_control.vehicle.gimbal import STILL, GimbalHistory
from follower_control.vehicle.history import AttitudeHistory
from follower_control.vehicle.state import Attitude, GimbalState
from follower_vision.geometry.box import Box
from follower_vision.geometry.camera_model import CameraModel
from follower_vision.geometry.line_of_sight import CameraMount, LineOfSight, rotation
from follower_vision.trackers.track import Track, TrackState

CAMERA = CameraModel.from_fov(640, 480, math.radians(50))
MIDDLE = Track(Box(320, 240, 30, 30), TrackState.TRACKING, 1.0, "test", 10.0, 0)
angle = st.floats(-3.0, 3.0)


def attitude(roll=0.0, pitch=0.0, yaw=0.0, time_s=10.0, rates=(0.0, 0.0, 0.0)) -> Attitude:
    return Attitude(roll, pitch, yaw, *rates, time_s)


def sight(gimbal: GimbalState, vehicle: Attitude) -> LineOfSight:
    attitudes, gimbals = AttitudeHistory(), GimbalHistory()
    assert attitudes.add(vehicle)
    assert gimbals.add(gimbal)
    observed = BearingObserver(CAMERA, CameraMount(pitch_rad=-1.0)).observe(
        MIDDLE, attitudes, gimbals
    )
    return observed.line_of_sight


@given(yaw=angle, pitch=st.floats(-1.4, 0.4), tilt=st.floats(-0.5, 0.5), heading=angle)
def test_a_levelled_gimbal_takes_out_the_vehicle_s_tilt_and_its_mount_does_not_count(
    yaw, pitch, tilt, heading
) -> None:
    vehicle = attitude(tilt, -tilt, heading)
    from_north = sight(GimbalState(attitude(0, pitch, yaw), from_north=True), vehicle)
    assert from_north.azimuth_rad == pytest.approx(yaw)
    assert from_north.elevation_rad == pytest.approx(pitch)
    from_nose = sight(GimbalState(attitude(0, pitch, yaw)), vehicle)
    turned = math.remainder(from_nose.azimuth_rad - yaw - heading, 2 * math.pi)
    assert turned == pytest.approx(0.0, abs=1e-9)


@given(pitch=st.floats(-1.0, 0.4), tilt=st.floats(-0.3, 0.3))
def test_one_that_is_not_levelled_tilts_with_the_vehicle(pitch, tilt) -> None:
    seen = sight(GimbalState(attitude(0, pitch, 0), is_level=False), attitude(0, tilt, 1.0))
    assert seen.elevation_rad == pytest.approx(pitch + tilt)
    assert seen.azimuth_rad == pytest.approx(1.0)


@given(pitch=st.floats(-1.0, 0.4), tilt=st.floats(-0.3, 0.3), heading=angle)
def test_its_yaw_from_north_is_not_turned_with_the_vehicle_once_more(pitch, tilt, heading) -> None:
    told = GimbalState(attitude(0, pitch, heading), is_level=False, from_north=True)
    seen = sight(told, attitude(0, tilt, heading))
    assert seen.elevation_rad == pytest.approx(pitch + tilt)
    assert math.remainder(seen.azimuth_rad - heading, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_between_two_times_the_camera_was_between_two_directions() -> None:
    history = GimbalHistory()
    history.add(GimbalState(attitude(0, -0.2, 0.0, 9.98)))
    history.add(GimbalState(attitude(0, -0.4, 0.2, 10.02)))
    held = history.at(10.0)
    assert held.attitude.pitch_rad == pytest.approx(-0.3)
    assert held.attitude.yaw_rad == pytest.approx(0.1)
    assert history.at(9.0) is None
    assert not history.add(GimbalState(attitude(0, math.nan, 0, 10.1)))


def test_without_the_gimbal_s_or_the_vehicle_s_attitude_nothing_is_said() -> None:
    attitudes, gimbals = AttitudeHistory(), GimbalHistory()
    observer = BearingObserver(CAMERA, CameraMount())
    gimbals.add(GimbalState(attitude()))
    assert observer.observe(MIDDLE, attitudes, gimbals) is None
    attitudes.add(attitude())
    assert observer.observe(MIDDLE, attitudes, GimbalHistory()) is None


def target(
    azimuth=0.0, elevation=0.0, rates=(0.0, 0.0), frame=BearingFrame.WORLD
) -> TargetEstimate:
    return TargetEstimate(
        10.0, azimuth, elevation, -2.0, *rates, 0.0, np.eye(6) * 1e-4, 10.0, frame
    )


SERVO = GimbalServo(GimbalSettings(enabled=True, gain_s=3.0))
LOOKS_NORTH = GimbalState(attitude(0, -0.4, 0.0), from_north=True)


@pytest.mark.parametrize(
    ("estimate", "pitch_sign", "yaw_sign"),
    [
        (target(0.2, -0.4), 0, 1),
        (target(-0.2, -0.4), 0, -1),
        (target(0.0, -0.2), 1, 0),
        (target(0.0, -0.6), -1, 0),
        (target(0.0, -0.4, (0.3, 0.0)), 0, 1),
        (target(0.0, -0.4, (0.0, 0.3)), 1, 0),
    ],
)
def test_it_turns_towards_the_target_and_with_it(estimate, pitch_sign, yaw_sign) -> None:
    rates = SERVO.update(estimate, LOOKS_NORTH, attitude(), 10.0)
    assert np.sign(round(rates.pitch_rad_s, 9)) == pitch_sign
    assert np.sign(round(rates.yaw_rad_s, 9)) == yaw_sign


@pytest.mark.parametrize(
    ("estimate", "gimbal", "vehicle", "now_s"),
    [
        (None, LOOKS_NORTH, attitude(), 10.0),
        (target(0.3), None, attitude(), 10.0),
        (target(0.3), LOOKS_NORTH, None, 10.0),
        (target(0.3), LOOKS_NORTH, attitude(), 11.0),
        (target(0.3, frame=BearingFrame.BODY), LOOKS_NORTH, attitude(), 10.0),
    ],
)
def test_where_something_is_missing_it_stands_still(estimate, gimbal, vehicle, now_s) -> None:
    assert SERVO.update(estimate, gimbal, vehicle, now_s) == STILL


@given(azimuth=angle, elevation=st.floats(-1.5, 1.5), yaw=angle, pitch=st.floats(-1.5, 0.5))
def test_rates_stay_within_limits_and_never_lead_over_an_end_stop(
    azimuth, elevation, yaw, pitch
) -> None:
    settings = GimbalSettings(enabled=True, max_rate_deg_s=40, lowest_deg=-60, highest_deg=10)
    gimbal = GimbalState(attitude(0, pitch, yaw), from_north=True)
    rates = GimbalServo(settings).update(target(azimuth, elevation), gimbal, attitude(), 10.0)
    most = math.radians(40) + 1e-9
    assert abs(rates.pitch_rad_s) <= most
    assert abs(rates.yaw_rad_s) <= most
    if pitch >= math.radians(10):
        assert rates.pitch_rad_s <= 0
    if pitch <= math.radians(-60):
        assert rates.pitch_rad_s >= 0


@given(azimuth=st.floats(-2.0, 2.0), elevation=st.floats(-1.2, 0.3))
def test_from_anywhere_the_target_comes_into_the_middle(azimuth, elevation) -> None:
    yaw, pitch = 0.0, -0.4
    for i in range(200):
        now = 10.0 + 0.02 * i
        gimbal = GimbalState(attitude(0, pitch, yaw, now), from_north=True)
        rates = SERVO.update(target(azimuth, elevation), gimbal, attitude(), now)
        yaw, pitch = yaw + 0.02 * rates.yaw_rad_s, pitch + 0.02 * rates.pitch_rad_s
    looks = rotation(0, pitch, yaw)[:, 0]
    assert looks @ LineOfSight(azimuth, elevation).vector > math.cos(0.02)
