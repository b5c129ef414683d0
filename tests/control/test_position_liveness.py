"""A position that repeats itself while it tells of a velocity is not believed."""

import math

from follower_control.liveness import PositionLiveness
from follower_control.vehicle import LocalPosition


def fed(speed_m_s: float, seconds: float, moves: bool) -> float:
    liveness = PositionLiveness()
    for step in range(round(seconds / 0.1) + 1):
        now_s = 0.1 * step
        north_m = speed_m_s * now_s if moves else 5.0
        liveness.note(LocalPosition(north_m, 0, -10, speed_m_s, 0, 0, now_s), now_s)
    return liveness.age_s(seconds)


def test_nothing_is_known_before_the_first_position() -> None:
    assert PositionLiveness().age_s(1.0) == math.inf


def test_a_place_that_does_not_change_while_it_moves_grows_old() -> None:
    assert fed(3.0, 2.0, moves=False) > 1.9
    assert fed(3.0, 2.0, moves=True) < 0.15


def test_a_vehicle_that_stands_still_may_say_the_same_for_long() -> None:
    assert fed(0.0, 60.0, moves=False) < 0.15


def test_no_new_position_makes_it_grow_old() -> None:
    liveness = PositionLiveness()
    position = LocalPosition(0, 0, 0, 0, 0, 0, 0.0)
    liveness.note(position, 0.0)
    liveness.note(position, 5.0)
    assert liveness.age_s(5.0) == 5.0
