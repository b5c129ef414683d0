"""Where a lost target is looked for: in a world in which the vehicle turns as it is told."""

import math
from dataclasses import replace

import numpy as np
import pytest

from follower_control.servo.search import Search, SearchSettings
from follower_control.target.estimate import TargetEstimate
from follower_control.target.observation import BearingFrame, to_line_of_sight
from follower_control.vehicle.setpoint import HOLD
from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState

STEP_S = 0.05


def estimate(
    azimuth_deg: float, rate_deg_s: float = 0.0, frame: BearingFrame = BearingFrame.WORLD
) -> TargetEstimate:
    return TargetEstimate(
        time_s=0.0,
        azimuth_rad=math.radians(azimuth_deg),
        elevation_rad=-0.3,
        log_scale=-2.0,
        azimuth_rate_rad_s=math.radians(rate_deg_s),
        elevation_rate_rad_s=0.0,
        log_scale_rate_s=0.0,
        covariance=np.eye(6),
        last_seen_s=0.0,
        frame=frame,
    )


class Turntable:
    """A vehicle that turns and climbs exactly as asked."""

    def __init__(self, yaw_deg: float, **settings: float | bool) -> None:
        self.search = Search(SearchSettings(**settings))  # type: ignore[arg-type]
        self.yaw, self.height_m, self.now_s = math.radians(yaw_deg), 10.0, 0.0
        self.yaws: list[float] = []

    @property
    def vehicle(self) -> VehicleState:
        attitude = Attitude(0.0, 0.0, self.yaw, 0.0, 0.0, 0.0, self.now_s)
        position = LocalPosition(0.0, 0.0, -self.height_m, 0.0, 0.0, 0.0, self.now_s)
        return VehicleState(attitude=attitude, position=position)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.now_s += STEP_S
            asked = self.search.update(self.vehicle, self.now_s)
            assert (asked.forward_m_s, asked.right_m_s) == (0.0, 0.0)
            assert abs(asked.yaw_rate_rad_s) <= math.radians(20) + 1e-12
            self.yaw += asked.yaw_rate_rad_s * STEP_S
            self.height_m -= asked.down_m_s * STEP_S
            self.yaws.append(math.degrees(self.yaw))


@pytest.mark.parametrize(("yaw_deg", "azimuth_deg"), [(0, 40), (0, -40), (170, -170), (-175, 160)])
def test_it_turns_the_short_way_to_where_the_target_was(yaw_deg: int, azimuth_deg: int) -> None:
    table = Turntable(yaw_deg, sweep_deg=0.0)
    table.search.start(estimate(azimuth_deg), table.vehicle)
    table.run(0.5)
    short_way = (azimuth_deg - yaw_deg + 180) % 360 - 180
    assert math.copysign(1, table.yaws[-1] - yaw_deg) == math.copysign(1, short_way)
    table.run(6.0)
    assert math.cos(table.yaw - math.radians(azimuth_deg)) > math.cos(math.radians(3))


def test_it_looks_ahead_of_a_target_that_moved_but_not_far() -> None:
    table = Turntable(0.0, sweep_deg=0.0)
    table.search.start(estimate(10.0, rate_deg_s=15.0), table.vehicle)
    table.run(6.0)
    assert table.yaws[-1] == pytest.approx(25.0, abs=3.1)
    table.search.start(estimate(10.0, rate_deg_s=500.0), table.vehicle)
    table.run(8.0)
    assert table.yaws[-1] == pytest.approx(40.0, abs=3.1)


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 180.0, -90.0])
def test_a_target_that_was_below_is_looked_for_where_it_left(azimuth_deg: float) -> None:
    azimuth = math.radians(azimuth_deg)
    away = np.array([math.cos(azimuth), math.sin(azimuth), 1.5])
    sight = to_line_of_sight(away, BearingFrame.DOWN)
    below = replace(
        estimate(math.degrees(sight.azimuth_rad), 30.0, BearingFrame.DOWN),
        elevation_rad=sight.elevation_rad,
    )
    table = Turntable(azimuth_deg, sweep_deg=30.0)
    table.search.start(below, table.vehicle)
    table.run(20.0)
    assert max(abs(yaw - azimuth_deg) for yaw in table.yaws[: round(1.0 / STEP_S)]) < 3.0
    assert max(table.yaws) + min(table.yaws) == pytest.approx(2 * azimuth_deg, abs=20.0)


def test_it_then_looks_ever_farther_to_both_sides_first_to_where_the_target_left() -> None:
    table = Turntable(0.0, look_s=1.0, sweep_deg=20.0)
    table.search.start(estimate(-10.0), table.vehicle)
    table.run(30.0)
    turns = [
        b
        for a, b, c in zip(table.yaws, table.yaws[1:], table.yaws[2:], strict=False)
        if (b - a) * (c - b) < 0
    ]
    assert turns[:4] == pytest.approx([-30.0, 10.0, -50.0, 30.0], abs=4.0)


def test_it_turns_on_with_a_target_that_is_believed_to_go_on_until_that_was_looked_at() -> None:
    table = Turntable(0.0, look_s=1.0, sweep_deg=20.0)
    table.search.start(estimate(0.0), table.vehicle)
    for azimuth_deg in np.arange(0.0, 30.0, 0.5).tolist():
        table.search.aim(estimate(azimuth_deg, rate_deg_s=10.0))
        table.run(STEP_S)
    table.run(0.4)
    assert table.yaws[-1] == pytest.approx(29.5, abs=4.0)
    table.run(2.0)
    assert max(table.yaws) > 36.0, "first to the side to which it moves"
    table.search.aim(estimate(-90.0))
    table.run(0.5)
    assert table.yaws[-1] > 20.0, "and is not called back then"


def test_it_looks_as_far_as_the_target_may_be_first_to_the_side_to_which_it_moved() -> None:
    table = Turntable(0.0, look_s=1.0, sweep_deg=20.0)
    table.search.start(estimate(0.0, rate_deg_s=1.0), table.vehicle)
    table.search.spread(np.radians([-110.0, 0.0, 120.0]))
    half_deg = 35.0
    table.run(6.0)
    assert max(table.yaws) + half_deg > 120.0
    assert min(table.yaws) >= 0.0
    table.run(15.0)
    assert max(table.yaws) + half_deg > 120.0
    assert max(table.yaws) < 120.0, "and no farther than is needed to see it"
    assert min(table.yaws) - half_deg < -110.0


def test_from_side_to_side_it_always_turns_by_way_of_the_middle() -> None:
    table = Turntable(0.0, look_s=0.0, sweep_deg=170.0)
    table.search.start(estimate(0.0), table.vehicle)
    table.run(60.0)
    assert max(np.abs(table.yaws)) < 180.0
    crossings = np.sum(np.diff(np.sign(table.yaws)) != 0)
    assert crossings >= 2, "what lies before it is looked at again and again"
    assert max(table.yaws) + 35.0 > 180.0 - 35.0
    assert min(table.yaws) - 35.0 < -180.0 + 35.0


@pytest.mark.parametrize("drift_deg_s", [-8.0, 0.0, 8.0])
@pytest.mark.parametrize("begin_deg", range(-180, 180, 30))
def test_what_may_be_on_every_side_is_seen_within_one_turn(
    begin_deg: float, drift_deg_s: float
) -> None:
    rate_deg_s, half_deg = 20.0, 35.0
    table = Turntable(0.0, look_s=0.0, sweep_deg=20.0)
    table.search.start(estimate(0.0), table.vehicle)
    table.search.spread(np.radians([-170.0, 0.0, 170.0]))
    table.run(360.0 / (rate_deg_s - abs(drift_deg_s)))
    target_deg = begin_deg + drift_deg_s * STEP_S * np.arange(len(table.yaws))
    off_deg = (target_deg - np.array(table.yaws) + 180.0) % 360.0 - 180.0
    assert np.min(np.abs(off_deg)) < half_deg


def test_without_a_guess_it_looks_as_before() -> None:
    plain, told = (Turntable(0.0, look_s=1.0, sweep_deg=20.0) for _ in range(2))
    for table in (plain, told):
        table.search.start(estimate(0.0), table.vehicle)
    told.search.spread(None)
    told.search.spread(np.radians([-10.0, 10.0]))
    for table in (plain, told):
        table.run(8.0)
    assert plain.yaws == told.yaws


@pytest.mark.parametrize(
    ("guess_deg", "looks_aside_s"), [([-20.0, 20.0], 4.0), ([-40.0, 20.0], 1.0), ([], 1.0)]
)
def test_it_stays_while_all_of_where_the_target_may_be_is_in_view_but_not_for_ever(
    guess_deg: list[float], looks_aside_s: float
) -> None:
    table = Turntable(0.0, look_s=1.0, stay_s=3.0, sweep_deg=20.0)
    table.search.start(estimate(0.0), table.vehicle)
    table.search.spread(np.radians(guess_deg))
    table.run(looks_aside_s)
    assert max(np.abs(table.yaws)) == 0.0
    table.run(2.0)
    assert max(np.abs(table.yaws)) > 10.0


def test_it_climbs_by_so_much_and_no_higher() -> None:
    table = Turntable(0.0, climb_m=4.0)
    table.search.start(estimate(0.0), table.vehicle)
    table.run(1.0)
    assert table.height_m == pytest.approx(11.0, abs=0.1)
    table.run(10.0)
    assert table.height_m == pytest.approx(14.0, abs=0.1)


def test_by_itself_it_keeps_its_height() -> None:
    table = Turntable(0.0)
    table.search.start(estimate(30.0), table.vehicle)
    table.run(5.0)
    assert table.height_m == 10.0


def test_what_is_not_known_is_not_moved_by() -> None:
    table = Turntable(0.0, climb_m=4.0)
    for last in (None, estimate(30.0, frame=BearingFrame.BODY)):
        table.search.start(last, replace(table.vehicle, position=None))
        assert table.search.update(table.vehicle, 0.0) == HOLD
    table.search.start(estimate(30.0), table.vehicle)
    assert table.search.update(table.vehicle, 5.0) == HOLD  # telemetry is old
    still = Turntable(0.0, turn=False)
    still.search.start(estimate(30.0), still.vehicle)
    still.run(1.0)
    assert still.yaw == 0.0
