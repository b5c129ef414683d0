"""Going round a target at a rate, and turning the nose to its course from above."""

import cmath
import math
from itertools import pairwise

import pytest

from follower_control.servo.lateral import LateralControl, OverheadControl
from follower_control.servo.settings import FollowMode, OverheadYaw, ServoSettings
from follower_control.target.world_filter import TargetMotion

DT = 0.02


def moving(course_deg: float | None = None) -> TargetMotion:
    """Return a target that stands, or goes at 3 m/s."""
    motion = TargetMotion(0.0)
    if course_deg is not None:
        velocity = cmath.rect(3.0, math.radians(course_deg))
        for _ in range(3):
            motion.update(velocity, DT)
    return motion


def circled(settings: ServoSettings, seconds: float, distance_m: float) -> list[complex]:
    """Fly round a target at the origin, obeying at once and keeping the distance; our places."""
    sideways = LateralControl(settings)
    sideways.start(FollowMode.ORBIT)
    place, rate, places, right = complex(-distance_m, 0.0), 0j, [], 0.0
    for _ in range(round(seconds / DT)):
        right = sideways.update(-place, rate, moving(), 0.0, right, DT)
        azimuth = cmath.phase(-place)
        velocity = right * cmath.rect(1.0, azimuth + math.pi / 2)
        rate = -velocity
        place += velocity * DT
        place *= distance_m / abs(place)
        places.append(place)
    return places


@pytest.mark.parametrize("rate_deg_s", [12.0, -12.0])
@pytest.mark.parametrize("distance_m", [8.0, 16.0])
def test_a_rate_of_going_round_is_kept_at_any_distance(rate_deg_s: float, distance_m: float):
    settings = ServoSettings(mode=FollowMode.ORBIT, orbit_deg_s=rate_deg_s, distance_m=distance_m)
    places = circled(settings, 12.0, distance_m)
    turned = [cmath.phase(after / before) for before, after in pairwise(places[300:])]
    assert math.degrees(sum(turned)) / (DT * len(turned)) == pytest.approx(rate_deg_s, rel=0.02)


def test_a_speed_of_going_round_is_a_slower_rate_farther_out():
    for distance_m in (8.0, 16.0):
        settings = ServoSettings(mode=FollowMode.ORBIT, orbit_m_s=2.0, distance_m=distance_m)
        places = circled(settings, 8.0, distance_m)
        assert abs(places[-1] - places[-2]) / DT == pytest.approx(2.0, rel=0.02)


@pytest.mark.parametrize("level_m", [6.0, 15.0, 30.0])
def test_going_round_is_as_fast_as_the_velocity_across_may_be_at_any_distance(level_m: float):
    settings = ServoSettings(mode=FollowMode.ORBIT, orbit_deg_s=60.0, max_sideways_m_s=3.0)
    places = circled(settings, 8.0, level_m)
    assert abs(places[-1] - places[-2]) / DT == pytest.approx(3.0, rel=1e-3)


@pytest.mark.parametrize("level_m", [6.0, 15.0, 30.0])
def test_it_swings_to_its_side_no_faster_than_the_velocity_across_may_be(level_m: float):
    settings = ServoSettings(mode=FollowMode.SIDE, max_sideways_m_s=3.0)
    sideways, standing = LateralControl(settings), moving(0.0)
    standing.velocity_m_s = 0j
    sideways.start(FollowMode.SIDE)
    swings = [sideways.update(level_m + 0j, 0j, standing, 0.0, 0.0, DT) for _ in range(400)]
    assert max(map(abs, swings)) == pytest.approx(3.0, abs=1e-3)


@pytest.mark.parametrize(
    ("yaw_deg", "course_deg", "turn_deg"),
    [(0, 90, 90), (90, 0, -90), (170, -170, 20), (-170, 170, -20), (30, 30, 0)],
)
def test_from_above_the_nose_turns_to_the_course_the_shorter_way(
    yaw_deg: float, course_deg: float, turn_deg: float
):
    target = moving(course_deg)
    course = OverheadControl(
        ServoSettings(mode=FollowMode.OVERHEAD, overhead_yaw=OverheadYaw.COURSE)
    )
    error = course.heading_error(target, math.radians(yaw_deg))
    assert math.degrees(error) == pytest.approx(turn_deg, abs=1e-9)
    free = OverheadControl(ServoSettings(mode=FollowMode.OVERHEAD))
    assert free.heading_error(target, math.radians(yaw_deg)) == 0.0


def test_from_above_the_nose_stays_while_the_course_is_not_known():
    course = OverheadControl(
        ServoSettings(mode=FollowMode.OVERHEAD, overhead_yaw=OverheadYaw.COURSE)
    )
    assert course.heading_error(moving(), 1.0) == 0.0
