"""What repeats itself to the last bit is not believed; what is no number goes no further."""

import math
from dataclasses import fields, replace

import pytest

from follower_control.vehicle.stale_data import (
    REPEATS,
    PlausibleTelemetryFilter,
    StuckPositionDetector,
    StuckSensorDetector,
)
from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState


def fed(speed_m_s: float, seconds: float, moves: bool) -> float:
    liveness = StuckPositionDetector()
    for step in range(round(seconds / 0.1) + 1):
        now_s = 0.1 * step
        north_m = speed_m_s * now_s if moves else 5.0
        liveness.note(LocalPosition(north_m, 0, -10, speed_m_s, 0, 0, now_s), now_s)
    return liveness.age_s(seconds)


def attitude(roll_rad: float, time_s: float) -> Attitude:
    return Attitude(roll_rad, 0.1, 0.2, 0.0, 0.0, 0.0, time_s)


def test_nothing_is_known_before_the_first() -> None:
    assert StuckPositionDetector().age_s(1.0) == math.inf
    assert StuckSensorDetector().age_s(1.0) == math.inf


def test_an_attitude_that_comes_again_and_again_is_given_up_at_once() -> None:
    liveness = StuckSensorDetector()
    for step in range(REPEATS):
        liveness.note(attitude(0.05, 0.02 * step), 0.02 * step)
    assert liveness.age_s(0.1) == 0.1
    liveness.note(attitude(0.05, 0.1), 0.1)
    assert liveness.age_s(0.1) == math.inf
    liveness.note(attitude(0.051, 0.12), 0.12)
    assert liveness.age_s(0.13) < 0.02


def test_an_attitude_that_lives_is_as_old_as_its_last_change() -> None:
    liveness = StuckSensorDetector()
    for step in range(100):
        liveness.note(attitude(1e-7 * step, 0.02 * step), 0.02 * step)
        assert liveness.age_s(0.02 * step) == 0.0


def test_a_place_that_does_not_change_while_it_moves_grows_old() -> None:
    assert fed(3.0, 0.1 * (REPEATS - 1), moves=False) == 0.1 * (REPEATS - 1)
    assert fed(3.0, 0.1 * REPEATS, moves=False) == math.inf
    assert fed(3.0, 2.0, moves=True) < 0.15


def test_a_vehicle_that_stands_still_may_say_the_same_for_long() -> None:
    assert fed(0.0, 60.0, moves=False) < 0.15


def test_no_new_position_makes_it_grow_old() -> None:
    liveness = StuckPositionDetector()
    position = LocalPosition(0, 0, 0, 0, 0, 0, 0.0)
    liveness.note(position, 0.0)
    liveness.note(position, 5.0)
    assert liveness.age_s(5.0) == 5.0


def test_a_position_that_a_replay_has_read_anew_is_no_repetition() -> None:
    liveness = StuckPositionDetector()
    for step in range(2 * REPEATS):
        liveness.note(LocalPosition(5, 0, -10, 2, 0, 0, 0.0), 0.02 * step)
    assert liveness.age_s(0.2) == 0.2


def test_a_place_that_does_not_change_while_the_vehicle_is_sent_away_is_not_believed() -> None:
    liveness = StuckPositionDetector()
    for step in range(30):
        now_s = 0.1 * step
        liveness.note(LocalPosition(5, 0, -10, 0, 0, 0, now_s), now_s, sent_m=0.101)
        assert liveness.age_s(now_s) == (0.0 if step < 20 else math.inf)
    for step in range(30, 60):
        now_s = 0.1 * step
        liveness.note(LocalPosition(5, 0, -10, 0, 0, 0, now_s), now_s, sent_m=0.0)
        assert liveness.age_s(now_s) == math.inf, "it is held, and says nothing new"
    liveness.note(LocalPosition(5.001, 0, -10, 0, 0, 0, 6.0), 6.0)
    assert liveness.age_s(6.0) == 0.0


def test_a_place_that_changes_is_believed_however_far_the_vehicle_is_sent() -> None:
    liveness = StuckPositionDetector()
    for step in range(100):
        now_s = 0.1 * step
        liveness.note(LocalPosition(1e-3 * (step // 4), 0, -10, 0, 0, 0, now_s), now_s, 0.4)
        assert liveness.age_s(now_s) == 0.0


ATTITUDE = Attitude(0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 5.0)
POSITION = LocalPosition(1.0, 2.0, -3.0, 0.0, 0.0, 0.0, 5.0)
SOUND = VehicleState(ATTITUDE, POSITION, "GUIDED", True, True, False, 5.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", [field.name for field in fields(Attitude)])
def test_an_attitude_that_is_no_number_is_the_one_before(name: str, bad: float) -> None:
    sound = PlausibleTelemetryFilter()
    assert sound.of(SOUND) is SOUND
    attitude = replace(replace(ATTITUDE, time_s=6.0), **{name: bad})
    broken = replace(SOUND, attitude=attitude, heartbeat_s=6.0)
    kept = sound.of(broken)
    assert kept == replace(SOUND, heartbeat_s=6.0)
    assert kept.attitude_age_s(6.0) == 1.0


@pytest.mark.parametrize(("name", "bad"), [("down_m", math.nan), ("east_m_s", -1e30)])
def test_a_position_that_is_no_number_or_too_fast_is_the_one_before(name: str, bad: float) -> None:
    sound = PlausibleTelemetryFilter()
    sound.of(SOUND)
    newer = replace(ATTITUDE, time_s=6.0)
    broken = replace(SOUND, attitude=newer, position=replace(POSITION, **{name: bad}))
    assert sound.of(broken) == replace(SOUND, attitude=newer)


def test_before_the_first_sound_one_there_is_none() -> None:
    broken = replace(SOUND, attitude=replace(ATTITUDE, roll_rad=math.nan))
    assert PlausibleTelemetryFilter().of(broken) == replace(SOUND, attitude=None)
