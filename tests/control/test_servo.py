"""The servo's signs, limits, modes, and what it does without telemetry or after a pause."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from follower_control.servo.output_blend import StickOffset
from follower_control.servo.pid import PidSettings
from follower_control.servo.servo import VisualServo
from follower_control.servo.settings import FollowMode, ServoSettings
from follower_control.target.estimate import TargetEstimate, level_rate, reproject
from follower_control.target.observation import BearingFrame
from follower_control.vehicle.setpoint import HOLD, VelocitySetpoint
from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState

SIZE, DISTANCE, DT = 1.5, 15.0, 0.02
SETTINGS = ServoSettings(target_size_m=SIZE, distance_m=DISTANCE)
MOUNT_PITCH = math.radians(-20)


def target(range_m=DISTANCE, azimuth_deg=0.0, elevation_deg=-20.0, **others) -> TargetEstimate:
    start = TargetEstimate(
        time_s=0.0,
        azimuth_rad=math.radians(azimuth_deg),
        elevation_rad=math.radians(elevation_deg),
        log_scale=math.log(SIZE / range_m),
        azimuth_rate_rad_s=0.0,
        elevation_rate_rad_s=0.0,
        log_scale_rate_s=0.0,
        covariance=np.eye(6),
        last_seen_s=0.0,
        frame=BearingFrame.WORLD,
    )
    return replace(start, **others)


def vehicle(time_s=0.0, yaw_deg=0.0, north_m_s=0.0, east_m_s=0.0) -> VehicleState:
    return VehicleState(
        attitude=Attitude(0, 0, math.radians(yaw_deg), 0, 0, 0, time_s),
        position=LocalPosition(0, 0, -5, north_m_s, east_m_s, 0, time_s),
    )


def answer(estimate, settings=SETTINGS, steps=150, present=HOLD, state=None, **pose):
    """Show the same for three seconds, carrying everything out; return the last setpoint."""
    servo = VisualServo(settings, MOUNT_PITCH)
    servo.start(present)
    asked = present
    for i in range(steps):
        now = replace(estimate, time_s=i * DT, last_seen_s=i * DT)
        seen = vehicle(i * DT, **pose) if state is None else state
        asked = servo.update(now, seen, asked)
    return asked


def test_on_target_at_rest_it_stands_still():
    assert answer(target()).values == pytest.approx((0, 0, 0, 0), abs=1e-9)


@pytest.mark.parametrize(
    ("estimate", "index", "sign"),
    [
        (target(azimuth_deg=8), 3, 1),
        (target(azimuth_deg=-8), 3, -1),
        (target(elevation_deg=-10), 2, -1),
        (target(elevation_deg=-30), 2, 1),
        (target(range_m=25), 0, 1),
        (target(range_m=10), 0, -1),
    ],
    ids=["right turns right", "left turns left", "above climbs", "below sinks", "far", "near"],
)
def test_signs(estimate, index, sign):
    values = answer(estimate).values
    assert values[index] * sign > 0.1
    others = [value for i, value in enumerate(values) if i != index]
    assert others == pytest.approx([0, 0, 0], abs=1e-9)


@pytest.mark.parametrize("yaw_deg", [0, 100, 179, -179])
def test_the_azimuth_error_is_against_the_present_heading_and_the_short_way(yaw_deg):
    right = answer(target(azimuth_deg=yaw_deg + 5), yaw_deg=yaw_deg)
    left = answer(target(azimuth_deg=yaw_deg - 5), yaw_deg=yaw_deg)
    assert right.yaw_rate_rad_s == pytest.approx(-left.yaw_rate_rad_s)
    assert 0.05 < right.yaw_rate_rad_s < 0.5


def passing(seconds, north_m_s=0.0, east_m_s=0.0, away_m=DISTANCE):
    """Follow a target that drives off while we stand, level; the servo and its last setpoint."""
    servo = VisualServo(replace(SETTINGS, elevation_deg=0.0))
    servo.start()
    asked = HOLD
    for i in range(round(seconds / DT)):
        north, east = away_m + north_m_s * i * DT, east_m_s * i * DT
        azimuth_deg, range_m = math.degrees(math.atan2(east, north)), math.hypot(north, east)
        seen = target(range_m, azimuth_deg, 0.0, time_s=i * DT, last_seen_s=i * DT)
        asked = servo.update(seen, vehicle(i * DT, yaw_deg=azimuth_deg), asked)
    return servo, asked


def test_a_target_moving_sideways_is_turned_after_at_its_own_rate():
    _, asked = passing(4.0, east_m_s=0.5)
    assert asked.yaw_rate_rad_s == pytest.approx(0.5 / DISTANCE, rel=0.1)


def test_without_telemetry_of_our_place_the_seen_rate_is_taken():
    blind = replace(vehicle(), position=None)
    servo, asked = VisualServo(SETTINGS, MOUNT_PITCH), HOLD
    servo.start()
    for i in range(150):
        state = replace(blind, attitude=replace(blind.attitude, time_s=i * DT))
        asked = servo.update(
            replace(target(azimuth_rate_rad_s=0.35), time_s=i * DT, last_seen_s=i * DT),
            state, asked,
        )  # fmt: skip
    assert asked.yaw_rate_rad_s == pytest.approx(0.35, abs=1e-3)


def test_the_heading_is_carried_on_to_the_estimate_s_time():
    turning = replace(vehicle(), attitude=Attitude(0, 0, 0, 0, 0, 1.0, 0.0))
    servo = VisualServo(SETTINGS, MOUNT_PITCH)
    servo.update(replace(target(), time_s=0.05), turning, HOLD)
    assert servo.errors.azimuth_rad == pytest.approx(-0.05)


def test_a_car_driving_away_is_followed_at_its_speed():
    """At the wanted range, closing in by nothing: our own speed is the target's."""
    asked = answer(target(), north_m_s=6.0)
    assert asked.forward_m_s == pytest.approx(6.0, abs=0.02)


@pytest.mark.parametrize(
    ("sent_m_s", "flown_m_s", "asked_m_s"),
    [(5.0, 4.5, 5.0), (5.0, 1.0, 2.0), (5.0, 6.0, 6.0), (0.0, 0.5, 0.5)],
    ids=["a tenth slower", "by a fifth at most", "not where it is faster", "not at rest"],
)
def test_a_vehicle_that_stays_behind_is_asked_for_as_much_more(sent_m_s, flown_m_s, asked_m_s):
    no_integral = replace(SETTINGS, range=PidSettings(kp=0.5, ki=0.0))
    servo = VisualServo(no_integral, MOUNT_PITCH)
    sent = VelocitySetpoint(forward_m_s=sent_m_s)
    servo.start(sent)
    for i in range(1000):
        now = replace(target(), time_s=i * DT, last_seen_s=i * DT)
        asked = servo.update(now, vehicle(i * DT, north_m_s=flown_m_s), sent)
    assert asked.forward_m_s == pytest.approx(asked_m_s, abs=0.02)


def test_an_old_velocity_is_none_to_stay_behind_by():
    asked = []
    for position in (None, vehicle(north_m_s=1.0).position):
        servo, sent = VisualServo(SETTINGS, MOUNT_PITCH), VelocitySetpoint(forward_m_s=5.0)
        servo.start(sent)
        for i in range(400):
            time_s = 1.0 + i * DT
            now = replace(target(), time_s=time_s, last_seen_s=time_s)
            told = replace(vehicle(time_s), position=position)
            setpoint = servo.update(now, told, sent)
        asked.append(setpoint)
    assert asked[0] == asked[1]


def test_a_growing_range_is_followed_before_it_has_become_an_error():
    """What is fed forward is the target's speed, whatever the distance grows to."""
    servo, _ = passing(6.0, north_m_s=3.0)
    assert servo.errors.target_speed_m_s == pytest.approx(3.0, rel=0.05)


def test_our_own_motion_is_not_taken_for_the_target_s():
    """The target stands; we speed up towards it, are seen to 0.2 s late, and climb."""
    servo, asked = VisualServo(SETTINGS, MOUNT_PITCH), HOLD
    servo.start()
    far_m, speeds = 60.0, []
    for i in range(200):
        now_s = i * DT
        seen_s = max(0.0, now_s - 0.2)
        forward, below = far_m - seen_s**2, 5.0 + 0.3 * seen_s
        range_m = math.hypot(forward, below)
        seen = target(range_m, 0.0, -math.degrees(math.atan2(below, forward)))
        position = LocalPosition(0, 0, -5 - 0.3 * now_s, 2 * now_s, 0, -0.3, now_s)
        state = replace(vehicle(now_s), position=position)
        asked = servo.update(replace(seen, time_s=now_s, last_seen_s=seen_s), state, asked)
        speeds.append(servo.errors.target_speed_m_s)
    assert max(map(abs, speeds)) < 0.02
    assert servo.errors.range_m == pytest.approx(math.hypot(far_m - 3.98**2, 6.194), rel=1e-3)


def test_a_jump_of_our_position_is_no_jump_of_the_target():
    servo, asked = VisualServo(SETTINGS, MOUNT_PITCH), HOLD
    servo.start()
    for i in range(200):
        position = LocalPosition(0 if i < 100 else 8, 0, -5, 0, 0, 0, i * DT)
        state = replace(vehicle(i * DT), position=position)
        seen = target(time_s=i * DT, last_seen_s=max(0.0, i * DT - 0.2))
        asked = servo.update(seen, state, asked)
        assert servo.errors.range_m == pytest.approx(DISTANCE, rel=1e-6)
        assert asked.values == pytest.approx((0, 0, 0, 0), abs=1e-6)


def test_after_a_gap_in_our_velocities_an_unseen_target_may_be_anywhere():
    """How far we went meanwhile is not known, so neither is where it is from here."""
    servo = VisualServo(SETTINGS, MOUNT_PITCH)
    servo.start()
    for i in range(100):
        servo.update(target(time_s=i * DT, last_seen_s=i * DT), vehicle(i * DT), HOLD)
    directions = servo.pursuit.possible_bearings(vehicle(2.2), 2.2)
    assert directions is not None
    assert np.abs(directions).min() < 0.01
    assert servo.pursuit.possible_bearings(vehicle(2.2), 3.2) is None
    for now_s in (3.3, 3.4, 3.6):
        assert servo.pursuit.possible_bearings(vehicle(now_s, north_m_s=10.0), now_s) is None
        assert servo.pursuit.predicted_region(now_s) is None


def test_our_own_climbing_is_no_part_of_the_climb_that_is_fed_forward():
    away = np.array([12.0, 0.0, 5.0])
    rising = reproject(target(), away, np.array([0.0, 0.0, 1.5]), SIZE)
    closing = reproject(target(), away, np.array([-2.0, 0.0, 0.0]), SIZE)
    assert level_rate(rising, 13.0) == pytest.approx(0.0, abs=1e-12)
    assert level_rate(closing, 13.0) == pytest.approx(-2.0)
    assert rising.elevation_rate_rad_s == pytest.approx(-1.5 * 12.0 / 13.0**2)


def test_speed_across_the_line_of_sight_is_not_the_target_s():
    asked = answer(target(azimuth_deg=90), yaw_deg=90, north_m_s=6.0)
    assert asked.forward_m_s == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("range_m", [0.1, 1.0, 40.0, 1000.0])
@pytest.mark.parametrize("azimuth_deg", [-170, -20, 0, 60])
@pytest.mark.parametrize("elevation_deg", [-89, 0, 60])
def test_nothing_exceeds_the_settings_speeds(range_m, azimuth_deg, elevation_deg):
    asked = answer(target(range_m, azimuth_deg, elevation_deg, azimuth_rate_rad_s=3.0))
    assert -SETTINGS.max_backward_m_s - 1e-9 <= asked.forward_m_s
    assert asked.forward_m_s <= SETTINGS.max_forward_m_s + 1e-9
    assert abs(asked.down_m_s) <= SETTINGS.max_vertical_m_s
    assert abs(asked.yaw_rate_rad_s) <= math.radians(SETTINGS.max_yaw_rate_deg_s) + 1e-9
    assert asked.right_m_s == 0


@pytest.mark.slow
def test_forward_falls_smoothly_with_the_azimuth_error_and_ends_off_axis():
    settings = replace(SETTINGS, range=PidSettings(kp=0.5))
    errors_deg = range(0, 60, 2)
    speeds = [answer(target(40, error), settings).forward_m_s for error in errors_deg]
    assert speeds[0] == pytest.approx(speeds[5])
    assert all(b <= a + 1e-9 for a, b in pairwise(speeds))
    assert speeds[18:] == pytest.approx([0] * 12)
    largest_step = max(a - b for a, b in pairwise(speeds))
    assert largest_step < 0.15 * speeds[0]


def test_it_closes_in_no_faster_than_it_can_sink_with_the_target():
    settings = replace(SETTINGS, sink_share=0.5, elevation_deg=-25.0)
    far = target(50, 0, -25)
    slow = answer(far, settings).forward_m_s
    free = answer(far, replace(settings, sink_share=0.0)).forward_m_s
    sink_m_s = 0.5 * settings.max_vertical_m_s
    assert slow == pytest.approx(sink_m_s / math.tan(math.radians(25)), 0.01)
    assert slow < free
    level = answer(target(50, 0, 0), replace(settings, elevation_deg=0.0))
    assert level.forward_m_s == pytest.approx(free, rel=0.1), "one that is not below is not slowed"


@pytest.mark.parametrize("sink_share", [0.0, 0.8])
def test_closing_in_slower_begins_without_a_step(sink_share):
    present = VelocitySetpoint(4.0, 0.0, 0.0, 0.0)
    servo, asked = VisualServo(replace(SETTINGS, sink_share=sink_share), MOUNT_PITCH, 1.5), present
    servo.start(present)
    for i in range(50):
        before, estimate = asked, replace(target(30, 0, -25), time_s=i * DT)
        asked = servo.update(estimate, vehicle(i * DT, north_m_s=4.0), asked)
        assert asked.forward_m_s == pytest.approx(before.forward_m_s, abs=0.3)


def test_watching_only_turns():
    asked = answer(target(40, 10, 0), replace(SETTINGS, mode=FollowMode.WATCH))
    assert asked.yaw_rate_rad_s > 0.1
    assert (asked.forward_m_s, asked.right_m_s, asked.down_m_s) == (0, 0, 0)


def test_holding_height_neither_climbs_nor_sinks():
    asked = answer(target(25, 0, 10), replace(SETTINGS, hold_height=True))
    assert asked.down_m_s == 0
    assert asked.forward_m_s > 0


def test_another_elevation_than_the_camera_s_can_be_wanted():
    level = replace(SETTINGS, elevation_deg=-5.0)
    assert answer(target(elevation_deg=-5), level).down_m_s == pytest.approx(0)
    assert answer(target(elevation_deg=-20), level).down_m_s > 0.1


def test_the_same_angle_means_more_metres_from_farther_away():
    near = answer(target(12, elevation_deg=-21), steps=3)
    far = answer(target(24, elevation_deg=-21), steps=3)
    assert far.down_m_s == pytest.approx(2 * near.down_m_s, rel=1e-6)


def test_without_a_known_size_it_holds_what_it_saw_at_the_start():
    servo = VisualServo(ServoSettings(), MOUNT_PITCH)
    servo.start()
    allowed = HOLD
    for i in range(100):
        estimate = target(33.0 if i < 50 else 40.0, time_s=i * DT, last_seen_s=i * DT)
        allowed = servo.update(estimate, vehicle(i * DT), allowed)
        if i == 49:
            assert allowed.forward_m_s == pytest.approx(0)
    assert allowed.forward_m_s > 0.5
    assert servo.errors.log_range > 0.5 * math.log(40 / 33)
    servo.resume(allowed)
    servo.update(target(40.0, time_s=9.0, last_seen_s=9.0), vehicle(9.0), allowed)
    assert servo.errors.log_range == pytest.approx(math.log(40 / 33))
    servo.start(allowed)
    servo.update(target(40.0, time_s=9.1, last_seen_s=9.1), vehicle(9.1), allowed)
    assert servo.errors.log_range == pytest.approx(0)


def test_the_start_is_bumpless_and_then_moves_on_without_a_step():
    present = VelocitySetpoint(4.0, 0.0, -0.5, 0.3)
    servo = VisualServo(SETTINGS, MOUNT_PITCH)
    servo.start(present)
    asked, seen = present, []
    for i in range(200):
        estimate = replace(target(20, 5, -25), time_s=i * DT)
        asked = servo.update(estimate, vehicle(i * DT, north_m_s=4.0), asked)
        seen.append(asked.values)
    assert seen[0] == pytest.approx(present.values)
    assert seen[1] == pytest.approx(present.values, abs=5e-3)
    assert np.abs(np.diff(seen, axis=0)).max() < 0.3


def test_after_a_pause_it_continues_from_what_was_allowed():
    servo = VisualServo(SETTINGS, MOUNT_PITCH)
    servo.start()
    for i in range(50):
        servo.update(replace(target(30), time_s=i * DT), vehicle(i * DT), HOLD)
    allowed = VelocitySetpoint(1.0, 0.0, 0.2, 0.1)
    asked = servo.update(replace(target(30), time_s=5.0), vehicle(5.0), allowed)
    assert asked.values == pytest.approx(allowed.values)


def test_the_same_time_twice_gives_the_same_answer():
    servo = VisualServo(SETTINGS, MOUNT_PITCH)
    for i in range(10):
        asked = servo.update(replace(target(30), time_s=i * DT), vehicle(i * DT), HOLD)
    again = servo.update(replace(target(30), time_s=9 * DT), vehicle(9 * DT), HOLD)
    assert again == asked


def test_while_the_envelope_holds_it_the_integrals_do_not_grow():
    settings = replace(
        SETTINGS, range=PidSettings(kp=0.5, ki=0.5), elevation=PidSettings(kp=0.8, ki=0.5)
    )
    held, free = VisualServo(settings, MOUNT_PITCH), VisualServo(settings, MOUNT_PITCH)
    for i in range(500):
        estimate = replace(target(18, 0, -25), time_s=i * DT)
        stuck = held.update(estimate, vehicle(i * DT), HOLD)
    obeyed = HOLD
    for i in range(500):
        estimate = replace(target(18, 0, -25), time_s=i * DT)
        obeyed = free.update(estimate, vehicle(i * DT), obeyed)
    assert stuck.forward_m_s < 1.6 < 0.5 * obeyed.forward_m_s
    proportional = 0.8 * math.radians(5) * 18
    assert stuck.down_m_s == pytest.approx(proportional, rel=0.05)
    assert obeyed.down_m_s == SETTINGS.max_vertical_m_s


def test_with_the_image_alone_it_still_centres_and_closes_in():
    body = target(25, 8, -20, frame=BearingFrame.BODY)
    asked = answer(body, state=VehicleState())
    assert asked.yaw_rate_rad_s > 0.1
    assert asked.forward_m_s > 0.5


def test_in_the_body_s_frame_the_azimuth_rate_is_our_own_turning_and_not_fed_forward():
    body = target(azimuth_rate_rad_s=-0.5, frame=BearingFrame.BODY)
    assert answer(body, state=VehicleState()).yaw_rate_rad_s == pytest.approx(0)


@pytest.mark.parametrize("age_s", [1.0, math.inf], ids=["stale", "none"])
def test_a_world_direction_without_a_heading_holds(age_s):
    state = VehicleState() if math.isinf(age_s) else vehicle(-age_s)
    assert answer(target(30, 10), state=state, steps=5) == HOLD


def nudged(nudge):
    servo = VisualServo(SETTINGS, MOUNT_PITCH)
    servo.set_offset(nudge)
    asked = HOLD
    for i in range(60):
        asked = servo.update(replace(target(), time_s=i * DT), vehicle(i * DT), asked)
    return asked


@pytest.mark.parametrize(
    ("nudge", "index", "sign"),
    [
        (StickOffset(distance_m=4), 0, -1),
        (StickOffset(distance_m=-4), 0, 1),
        (StickOffset(elevation_rad=0.2), 2, 1),
        (StickOffset(elevation_rad=-0.2), 2, -1),
        (StickOffset(azimuth_rad=-0.2), 3, 1),
        (StickOffset(side_m_s=1.0), 1, 1),
    ],
    ids=["back off", "come closer", "lower", "higher", "nose right", "go right"],
)
def test_a_nudge_moves_a_vehicle_that_stood_right(nudge, index, sign):
    values = nudged(nudge).values
    assert values[index] * sign > 0.1
    assert [v for i, v in enumerate(values) if i != index] == pytest.approx([0] * 3, abs=1e-9)
