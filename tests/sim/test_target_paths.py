"""Targets move smoothly: position, velocity and heading belong together."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from follower_sim.paths.spline import Course, SpeedChange, SpeedProfile, TargetPath

PROFILE = SpeedProfile(
    [SpeedChange(2, 5, 1.5), SpeedChange(12, 0, 2.0), SpeedChange(20, 7, 1.5)],
)
WINDING = [(0, 0), (28, 2), (52, 16), (64, 42), (60, 70), (72, 96), (100, 108), (130, 98)]


@given(st.floats(0, 40))
def test_distance_is_the_integral_of_speed(time_s: float) -> None:
    step = 1e-4
    gained = PROFILE.distance_m(time_s + step) - PROFILE.distance_m(time_s)
    assert gained / step == pytest.approx(PROFILE.speed_m_s(time_s + step / 2), abs=1e-3)


@given(st.floats(0, 40))
def test_speed_changes_no_faster_than_asked(time_s: float) -> None:
    step = 1e-3
    change = PROFILE.speed_m_s(time_s + step) - PROFILE.speed_m_s(time_s)
    assert abs(change) / step <= 2.0 + 1e-6


def test_speeds_are_reached_in_the_time_of_the_closed_form() -> None:
    assert PROFILE.speed_m_s(2 + 1.5 * 5 / 1.5) == pytest.approx(5)
    assert PROFILE.speed_m_s(2 + 1.5 * 5 / 1.5 / 2) == pytest.approx(2.5)
    assert PROFILE.speed_m_s(12 + 1.5 * 5 / 2.0) == 0
    assert PROFILE.speed_m_s(19) == 0
    assert PROFILE.speed_m_s(100) == 7


def test_a_ramp_covers_the_mean_speed_times_its_duration() -> None:
    assert PROFILE.distance_m(7) - PROFILE.distance_m(2) == pytest.approx(2.5 * 5)


def test_nothing_moves_before_the_beginning() -> None:
    rolling = SpeedProfile([SpeedChange(0, 3)])
    assert rolling.distance_m(-1) == 0
    assert rolling.speed_m_s(-1) == 0
    assert rolling.speed_m_s(0) == 3


def test_overlapping_changes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"at 3 s begins before the one at 1 s has ended at 8.5 s"):
        SpeedProfile([SpeedChange(1, 5, 1.0), SpeedChange(3, 0, 1.0)])


@pytest.mark.parametrize("values", [(-1, 1, 1), (0, -1, 1), (0, 1, 0)])
def test_a_speed_change_refuses_nonsense(values: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="speed change"):
        SpeedChange(*values)


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("corners", ["winding", "rounded"])
def test_velocity_is_the_derivative_of_position(corners: str, closed: bool) -> None:
    course = Course(WINDING, corners, radius_m=12, closed=closed)  # type: ignore[arg-type]
    path = TargetPath(course, PROFILE)
    for time_s in np.linspace(1, 45, 200):
        before, now, after = (path.pose(time_s + dt) for dt in (-0.05, 0, 0.05))
        if not closed and after.distance_m > course.length_m:
            break
        moved = (np.array(after.position_m) - np.array(before.position_m)) / 0.1
        assert moved == pytest.approx(np.array(now.velocity_m_s), abs=0.15)
        if np.linalg.norm(now.velocity_m_s) > 0.5:
            flown = math.atan2(now.velocity_m_s[1], now.velocity_m_s[0])
            assert now.heading_rad == pytest.approx(flown)


def test_a_winding_course_goes_through_its_points() -> None:
    course = Course(WINDING)
    for point in WINDING:
        assert np.linalg.norm(course.line[:, :2] - point, axis=1).min() < 1e-6


def test_rounded_corners_have_the_radius_asked_for() -> None:
    course = Course([(0, 0), (100, 0), (100, 100)], "rounded", radius_m=20)
    assert course.length_m == pytest.approx(200 - 40 + math.pi * 20 / 2, abs=0.02)
    distances = np.linalg.norm(course.line[:, :2] - (80, 20), axis=1)
    assert distances.min() == pytest.approx(20, abs=1e-3)


@settings(max_examples=40)
@given(st.floats(5, 60), st.floats(-60, 60))
def test_the_heading_of_a_rounded_course_never_jumps(north: float, east: float) -> None:
    assume(math.hypot(north, east) > 5)
    course = Course([(0, 0), (40, 0), (40 + north, east)], "rounded", radius_m=2)
    directions = np.array([course.direction(s) for s in np.arange(37, 43, 0.1)])
    turns = np.einsum("ij,ij->i", directions[1:], directions[:-1])
    assert np.degrees(np.arccos(np.clip(turns, -1, 1))).max() < 12


@pytest.mark.parametrize("corners", ["winding", "rounded"])
@pytest.mark.parametrize("there", [(30, 0, 0), (0, -30, 0), (0, 0, 30)])
def test_a_course_that_turns_straight_back_turns_on_the_spot(
    corners: str, there: tuple[float, float, float]
) -> None:
    course = Course([(0, 0, 0), there, (0, 0, 0)], corners)  # type: ignore[arg-type]
    ahead, turning, back = (course.direction(course.length_m * x) for x in (0.25, 0.5, 0.75))
    assert ahead == pytest.approx(-back)
    assert float(ahead @ turning) == pytest.approx(0, abs=1e-9)
    assert np.linalg.norm((ahead, turning, back), axis=1) == pytest.approx(1)


def test_height_is_up() -> None:
    course = Course([(0, 0, 5), (30, 0, 15)])
    assert course.position(0)[2] == -5
    assert course.direction(10)[2] < 0


def test_a_closed_course_comes_round() -> None:
    course = Course(WINDING, closed=True)
    assert course.position(course.length_m + 7) == pytest.approx(course.position(7), abs=1e-9)
    assert course.position(course.length_m - 1e-6) == pytest.approx(course.position(0), abs=1e-5)


def test_at_the_end_of_an_open_course_the_target_stands() -> None:
    path = TargetPath(Course([(0, 0), (10, 0)]), SpeedProfile([SpeedChange(0, 5)]))
    assert path.pose(10).position_m == pytest.approx((10, 0, 0))
    assert path.pose(10).velocity_m_s == (0, 0, 0)
    assert path.shortfall_m(10) == pytest.approx(40)


@pytest.mark.parametrize(
    ("points", "options", "message"),
    [
        ([(0, 0)], {}, "at least 2 points"),
        ([(0, 0), (1, 0)], {"closed": True}, "at least 3 points"),
        ([(0, 0), (0, 0), (5, 0)], {}, "at one place"),
        ([(0, 0), (5, 0)], {"radius_m": 0}, "radius"),
    ],
)
def test_impossible_courses_are_refused(
    points: list[tuple[float, float]], options: dict[str, float], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        Course(points, **options)  # type: ignore[arg-type]
