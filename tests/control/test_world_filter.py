"""The target as a place in the world, and the way that we went ourselves."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_control.target.world_filter import TargetWorldFilter, place_noise
from follower_control.vehicle.history import PositionHistory
from follower_control.vehicle.state import LocalPosition

NOISE = place_noise(np.array([1.0, 0.0, 0.0]), along_m=2.0, across_m=0.1)
VELOCITY = np.array([3.0, -1.0, 0.2])


def followed(seconds: float = 12.0, hz: float = 30.0) -> TargetWorldFilter:
    """Return a target that goes steadily from (10, 5, -2), seen for so long."""
    target = TargetWorldFilter(1.5)
    for i in range(round(seconds * hz)):
        target.observe(np.array([10.0, 5.0, -2.0]) + VELOCITY * i / hz, NOISE, i / hz)
    return target


def test_a_steady_target_is_predicted_without_error() -> None:
    place, velocity = followed().at(14.0)
    assert velocity == pytest.approx(VELOCITY, abs=1e-3)
    assert place == pytest.approx(np.array([10.0, 5.0, -2.0]) + 14.0 * VELOCITY, abs=0.01)


def circling(turn_deg_s: float, speed: float = 5.0, seconds: float = 10.0) -> TargetWorldFilter:
    """Return a target that turns steadily, to the right if positive, seen until it goes north."""
    target, turn = TargetWorldFilter(1.5), math.radians(turn_deg_s)
    for t in np.arange(-seconds, 1e-9, 1 / 30).tolist():
        north, east = speed / turn * math.sin(turn * t), speed / turn * (1 - math.cos(turn * t))
        target.observe(np.array([north, east, 0.0]), NOISE * 0.01, t)
    return target


@pytest.mark.parametrize("turn_deg_s", [-25.0, 15.0, 25.0])
def test_a_target_that_turns_is_taken_to_turn_on_and_less_and_less(turn_deg_s: float) -> None:
    target, turn = circling(turn_deg_s), math.radians(turn_deg_s)
    place, _ = target.at(1.5)
    true = 5.0 / turn * np.array([math.sin(1.5 * turn), 1 - math.cos(1.5 * turn)])
    straight = np.array([7.5, 0.0])
    assert np.linalg.norm(place[:2] - true) < 0.6 * np.linalg.norm(straight - true)
    courses = [math.atan2(*target.at(t)[1][[1, 0]]) for t in (0.0, 1.0, 2.0, 20.0)]
    turned = np.diff(np.array(courses)) * np.sign(turn)
    assert turned[0] > turned[1] > 0
    assert abs(courses[-1]) < abs(turn) * 2.6
    assert np.linalg.norm(target.at(20.0)[1]) == pytest.approx(5.0, rel=0.1)


def test_across_the_line_of_sight_a_change_of_speed_may_be_followed_sooner() -> None:
    sights = np.array([1.0, 0.0, 0.0])

    def after_a_start(across_m_s2: float | None, axis: int) -> float:
        target = TargetWorldFilter(0.2, across_m_s2)
        for t in np.arange(0.0, 6.0, 1 / 30).tolist():
            place = np.zeros(3)
            place[axis] = 2.0 * max(t - 5.0, 0.0)
            target.observe(place, np.eye(3), t, sights)
        return float(target.at(6.0)[1][axis])

    assert after_a_start(1.5, axis=1) > 1.5 * after_a_start(None, axis=1)
    assert after_a_start(1.5, axis=0) == pytest.approx(after_a_start(None, axis=0), abs=0.02)


def test_a_target_that_hardly_moves_is_not_taken_to_turn() -> None:
    target, rng = TargetWorldFilter(1.5), np.random.default_rng(1)
    for t in np.arange(0.0, 8.0, 1 / 30).tolist():
        target.observe(rng.normal(0.0, 0.1, 3), NOISE * 0.01, t)
    now, later = (target.at(t) for t in (8.0, 11.0))
    assert np.linalg.norm(later[0] - now[0]) <= 3.0 * np.linalg.norm(now[1]) + 0.2


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(0.001, 2.0))
def test_whatever_is_seen_the_speed_stays_what_it_was(
    north: float, east: float, every_s: float
) -> None:
    target = TargetWorldFilter(1.5)
    for i in range(4):
        target.observe(np.array([north * i, east * i * i, 0.0]), NOISE, i * every_s)
    now, later = (target.at(3 * every_s + s)[1] for s in (0.0, 3.0))
    assert np.isfinite(later).all()
    assert np.linalg.norm(later) == pytest.approx(np.linalg.norm(now), rel=1e-9, abs=1e-9)


def test_what_is_not_newer_changes_nothing() -> None:
    target = followed(1.0)
    before = target.at(2.0)
    assert target.time_s is not None
    target.observe(np.zeros(3), NOISE, target.time_s)
    assert np.array_equal(np.array(target.at(2.0)), np.array(before))


def test_a_place_far_off_is_a_new_beginning_at_the_old_velocity() -> None:
    target = followed()
    _, velocity = target.at(12.0)
    far = np.array([500.0, 0.0, 0.0])
    target.observe(far, NOISE, 12.0)
    assert target.at(12.0)[0] == pytest.approx(far)
    assert target.at(12.0)[1] == pytest.approx(velocity)


def test_noise_lies_along_the_line_of_sight() -> None:
    slanted = np.array([0.6, 0.0, 0.8])
    noise = place_noise(slanted, along_m=2.0, across_m=0.1)
    assert slanted @ noise @ slanted == pytest.approx(4.0)
    across = np.array([-0.8, 0.0, 0.6])
    assert across @ noise @ across == pytest.approx(0.01)


def test_a_target_twice_as_large_is_twice_as_far_away() -> None:
    target = followed()
    here, before = np.array([1.0, 2.0, -3.0]), target.at(12.0)[0]
    still = TargetWorldFilter(1.5)
    still.observe(before, NOISE, 12.0)
    still.rescale(here, 2.0)
    assert still.at(12.0)[0] == pytest.approx(here + 2 * (before - here))


def test_how_well_it_is_known_is_told_along_a_direction_and_falls_while_unseen() -> None:
    north, east = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    target = followed()
    seen_s = target.time_s
    assert seen_s is not None
    assert target.deviation_m(seen_s, east) < 0.1 < target.deviation_m(seen_s, north) < 2.0
    unseen = [target.deviation_m(seen_s + i, north) for i in range(5)]
    assert unseen == sorted(unseen)
    # White acceleration alone: q t³ / 3, q = 1.5².
    assert unseen[4] > math.sqrt(1.5**2 * 4**3 / 3)


@given(
    ahead_s=st.floats(-5, 20),
    heading=st.floats(-math.pi, math.pi),
)
def test_how_well_it_is_known_is_finite_and_the_same_both_ways(ahead_s, heading) -> None:
    direction = np.array([math.cos(heading), math.sin(heading), 0.0])
    target = followed(0.2)
    deviation = target.deviation_m((target.time_s or 0.0) + ahead_s, direction)
    assert 0 <= deviation < math.inf
    assert deviation == pytest.approx(
        target.deviation_m((target.time_s or 0.0) + ahead_s, -direction)
    )


def told(now_s: float, north_m_s: float, north_m: float = 0.0) -> LocalPosition:
    return LocalPosition(north_m, 0.0, -5.0, north_m_s, 0.0, 0.0, now_s)


def test_the_way_is_added_up_from_velocities_whatever_positions_say() -> None:
    path = PositionHistory()
    kept = [path.add(told(0.02 * i, 0.2 * i, 99.0 * (i % 3))) for i in range(51)]
    assert kept == [False] + [True] * 50
    there, here = path.at(0.51), path.at(1.0)
    # v = 10 t: 5 t² metres.
    assert here[0] - there[0] == pytest.approx(5 * (1.0 - 0.51**2), abs=2e-3)


def test_after_the_newest_the_velocity_leads_on_for_a_moment() -> None:
    path = PositionHistory()
    path.add(told(0.0, 4.0))
    path.add(told(0.1, 4.0))
    soon = path.at(0.3)
    assert soon[0] == pytest.approx(1.2)
    assert path.at(0.7) is None
    assert path.at(-0.1) is None


@pytest.mark.parametrize("rate_hz", [10, 50, 200])
def test_the_way_of_the_last_six_seconds_is_known_whatever_the_rate(rate_hz: int) -> None:
    path = PositionHistory()
    for number in range(30 * rate_hz):
        path.add(told(number / rate_hz, 2.0))
    now_s = 30.0 - 1 / rate_hz
    here = path.at(now_s)
    for ago_s in (0.05, 1.234, 5.9):
        there = path.at(now_s - ago_s)
        assert here[0] - there[0] == pytest.approx(2.0 * ago_s)
    assert path.at(now_s - 6.1) is None


def test_a_gap_begins_another_path() -> None:
    path = PositionHistory()
    path.add(told(0.0, 4.0))
    assert not path.add(told(2.0, 4.0))
    assert path.at(1.0) is None
    again = path.at(2.0)
    assert not again.any()
    path.clear()
    assert path.at(2.0) is None


@pytest.mark.parametrize("rate_hz", [10, 30])
@pytest.mark.parametrize("speed", [15.0, 20.0])
def test_a_velocity_that_is_wrong_is_given_up(rate_hz: int, speed: float) -> None:
    """Passing close by: seen first at full speed; and left for a standing one beside it."""
    noise = place_noise(np.array([1.0, 0.0, 0.0]), 0.36, 0.06)
    target = TargetWorldFilter(1.5)
    for number in range(rate_hz):
        target.observe(np.array([12.0, speed * number / rate_hz, 0.0]), noise, number / rate_hz)
    assert target.at(1.0)[1][1] == pytest.approx(speed, rel=0.1)
    there = np.array([12.0, speed + 6.0, 0.0])
    for number in range(rate_hz, 2 * rate_hz + 1):
        target.observe(there, noise, number / rate_hz)
    assert abs(target.at(2.0)[1][1]) < 1.0


def test_a_single_place_that_is_far_off_leaves_the_velocity() -> None:
    noise = place_noise(np.array([1.0, 0.0, 0.0]), 0.36, 0.06)
    target = TargetWorldFilter(1.5)
    for number in range(90):
        off_m = 8.0 if number == 60 else 0.0
        target.observe(np.array([12.0, 0.1 * number + off_m, 0.0]), noise, number / 30)
        if number > 30:
            assert target.at(number / 30)[1][1] == pytest.approx(3.0, abs=1.0)


def test_where_it_may_be_spreads_with_the_time_and_holds_where_it_went() -> None:
    target = followed()
    place, velocity = target.at(12.0)
    for after_s, least_m in ((1.0, 0.5), (3.0, 5.0)):
        places = target.might_be_m(12.0 + after_s)
        off_m = places - place
        assert (
            np.linalg.norm(off_m[:, :2], axis=1).max() <= after_s * math.hypot(*velocity[:2]) + 0.5
        )
        assert np.ptp(places, axis=0)[:2].max() > least_m
        straight_on = np.linalg.norm(places - (place + after_s * velocity), axis=1).min()
        assert straight_on < 0.5


def test_errors_of_size_that_last_are_not_taken_for_motion() -> None:
    def fastest_m_s(slow_m: float) -> float:
        rng, error, north = np.random.default_rng(7), 0.0, np.array([1.0, 0.0, 0.0])
        target, speeds = TargetWorldFilter(0.6), []
        for number in range(1200):
            kept = math.exp(-1 / 30 / 1.5)
            error = kept * error + math.sqrt(1 - kept * kept) * float(rng.normal())
            seen = (12.0 + 0.96 * error) * north
            target.observe(seen, place_noise(north, 0.36, 0.06), number / 30, north, slow_m)
            speeds.append(abs(float(target.at(number / 30)[1][0])))
        return max(speeds[150:])

    assert fastest_m_s(0.96) < 0.7 * fastest_m_s(0.0)


def test_with_errors_of_size_that_last_it_still_comes_to_the_truth() -> None:
    north = np.array([1.0, 0.0, 0.0])
    target = TargetWorldFilter(0.6)
    for number in range(600):
        seen = (12.0 + 3.0 * number / 30) * north
        target.observe(seen, place_noise(north, 0.36, 0.06), number / 30, north, 0.96)
    place, velocity = target.at(599 / 30)
    assert place[0] == pytest.approx(12.0 + 3.0 * 599 / 30, abs=0.5)
    assert velocity[0] == pytest.approx(3.0, abs=0.1)
    assert 0.3 < target.deviation_m(599 / 30, north) < 1.2, "and knows what it does not know"


@pytest.mark.parametrize(("seconds", "is_believed"), [(0.4, False), (1.2, True)])
def test_a_place_far_off_is_believed_for_good_only_if_it_is_seen_there_for_a_while(
    seconds: float, is_believed: bool
) -> None:
    target = followed()
    place, velocity = target.at(12.0)
    noise = place_noise(np.array([1.0, 0.0, 0.0]), 0.36, 0.06)
    elsewhere = place + np.array([0.0, 30.0, 0.0])
    for now_s in np.arange(13.0, 13.0 + seconds, 1 / 30).tolist():
        target.observe(elsewhere, noise, now_s)
        assert np.linalg.norm(target.at(now_s)[0] - elsewhere) < 3.0, "meanwhile it is flown after"
    now_s += 1.0
    target.drop_unproven(now_s)
    straight_on = place + (now_s - 12.0) * velocity
    assert (np.linalg.norm(target.at(now_s)[0] - straight_on) < 2.0) is not is_believed
    target.observe(straight_on, noise, now_s)
    assert np.linalg.norm(target.at(now_s)[0] - straight_on) < 1.0, "where it is seen it is"


@pytest.mark.parametrize("off_m", [7.0, -7.0])
def test_a_glimpse_that_is_somewhat_off_turns_nothing_unless_it_lasts(off_m: float) -> None:
    def hidden_then_seen(seconds: float) -> TargetWorldFilter:
        target = TargetWorldFilter(1.5, 4.0)
        for number in range(360):
            at = number / 30
            target.observe(at * VELOCITY, NOISE, at, np.array([1.0, 0.0, 0.0]))
        for number in range(round(30 * seconds)):
            at = 13.0 + number / 30
            away = np.array([0.0, off_m, 0.0])
            target.observe(at * VELOCITY + away, NOISE, at, np.array([1.0, 0.0, 0.0]))
        target.drop_unproven(at + 0.3)
        return target

    glimpsed, seen = hidden_then_seen(0.25), hidden_then_seen(2.0)
    assert glimpsed.at(16.0)[0] == pytest.approx(16.0 * VELOCITY, abs=0.05)
    assert glimpsed.at(16.0)[1] == pytest.approx(VELOCITY, abs=0.05)
    assert seen.at(15.0)[0][1] - 15.0 * VELOCITY[1] == pytest.approx(off_m, abs=1.0)


def test_what_was_believed_of_a_jump_that_is_undone_is_forgotten_with_it() -> None:
    target = followed(3.0)
    believed_s = target.time_s
    assert believed_s is not None
    place, _ = target.at(believed_s)
    for now_s in np.arange(believed_s + 0.5, believed_s + 1.1, 1 / 30).tolist():
        target.observe(place + np.array([0.0, 25.0, 0.0]), NOISE, now_s)
    target.drop_unproven(now_s + 1.0)
    assert target.time_s == believed_s
    known = list(target.earlier())
    assert known
    for one in known:
        assert abs(one.at(believed_s)[0][1] - place[1]) < 5.0, "not to the east, where it jumped"
