"""What is kept of the distance where the ground is not level, as `range_from: ground` takes it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from follower.flight.control.guidance import Guidance
from follower.flight.supervision.supervisor import SupervisorState
from follower.settings.settings import load_settings
from follower_control.target.estimate import TargetEstimate
from follower_control.target.observation import BearingFrame
from follower_control.vehicle.state import Attitude, Clearance, LocalPosition, VehicleState

DT, PERSON_M, MIDDLE_M = 0.02, 0.9, 0.9
KEEP_OUT_M = 4.0
VELOCITY_LAG_S, CLIMB_LAG_S = 0.6, 0.4
GROUND = {
    "camera": {"pitch_deg": -27},
    "servo": {
        "range_from": "ground",
        "target_middle_m": MIDDLE_M,
        "distance_m": 9.0,
        "elevation_deg": -27.0,
    },
    "envelope": {"min_distance_m": KEEP_OUT_M},
}


@dataclass
class Walk:
    """A person walks north, a vehicle with the steering that flies follows.

    Attributes:
        ranges_m: true distances so far.
        told_m: distances that the servo took for true.
    """

    settings: dict[str, Any]
    ground: Callable[[float], float]
    rangefinder: bool = False
    speed_m_s: float = 1.2
    height_m: float = 5.0
    north_m: float = 0.0

    def __post_init__(self) -> None:
        self.steering = Guidance(load_settings(base=self.settings))
        self.ranges_m: list[float] = []
        self.told_m: list[float] = []
        self._forward = self._down = self._now_s = 0.0
        self.steering.begin(self._vehicle(), 0.0)

    def go(self, seconds: float) -> None:
        for _ in range(round(seconds / DT)):
            self._step()

    def _step(self) -> None:
        self._now_s += DT
        north = 9.0 + self.speed_m_s * self._now_s
        ahead, rise = north - self.north_m, self.ground(north) + MIDDLE_M - self.height_m
        range_m = math.hypot(ahead, rise)
        seen = TargetEstimate(
            self._now_s, 0.0 if ahead > 0 else math.pi, math.atan2(rise, abs(ahead)),
            math.log(PERSON_M / range_m), 0, 0, 0, np.eye(6) * 1e-5, self._now_s,
            BearingFrame.WORLD,
        )  # fmt: skip
        limited = self.steering.step(
            SupervisorState.FOLLOWING, self._now_s, seen, self._vehicle(), 0.0
        )
        self._forward += (limited.allowed.forward_m_s - self._forward) * DT / VELOCITY_LAG_S
        self._down += (limited.allowed.down_m_s - self._down) * DT / CLIMB_LAG_S
        self.north_m += self._forward * DT
        self.height_m -= self._down * DT
        self.ranges_m.append(range_m)
        self.told_m.append(self.steering.servo.errors.range_m)

    def _vehicle(self) -> VehicleState:
        now_s, over_m = self._now_s, self.height_m - self.ground(self.north_m)
        place = LocalPosition(
            self.north_m, 0.0, -self.height_m, self._forward, 0.0, self._down, now_s
        )
        return VehicleState(
            attitude=Attitude(0, 0, 0, 0, 0, 0, now_s),
            position=place,
            mode="GUIDED",
            obeys_setpoints=True,
            armed=True,
            landed=False,
            heartbeat_s=now_s,
            clearance=Clearance(over_m, now_s) if self.rangefinder else None,
        )


def hill(slope: float, rise_m: float) -> Callable[[float], float]:
    return lambda north: min(max((north - 14.0) * slope, 0.0), rise_m)


def test_on_level_ground_the_wanted_distance_is_kept() -> None:
    walk = Walk(GROUND, hill(0.0, 0.0))
    walk.go(20.0)
    assert walk.ranges_m[-1] == pytest.approx(9.0, abs=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("rangefinder", [False, True])
@pytest.mark.parametrize(("slope", "rise_m"), [(0.1, 3.0), (0.2, 5.0), (0.5, 5.0)])
def test_up_a_hill_it_does_not_fly_into_whom_it_follows(
    slope: float, rise_m: float, rangefinder: bool
) -> None:
    """The level ground behind a person who climbs is ever farther away; the person is not.

    By a rangefinder the ground is where we are, and errs by less.
    """
    walk = Walk(GROUND, hill(slope, rise_m), rangefinder)
    walk.go(30.0)
    assert min(walk.ranges_m) >= KEEP_OUT_M
    too_far = np.array(walk.told_m) / np.array(walk.ranges_m)
    needed = too_far[np.argmax(walk.told_m)] > 1.3
    assert needed == (not rangefinder)


def test_from_the_ground_to_the_size_in_flight_the_distance_stays() -> None:
    walk = Walk(GROUND, hill(0.0, 0.0), speed_m_s=0.0)
    walk.go(5.0)
    servo = GROUND["servo"] | {"range_from": "size"}
    walk.steering.change(load_settings(base=GROUND | {"servo": servo}))
    walk.go(3.0)
    assert walk.told_m[200:] == pytest.approx(walk.ranges_m[200:], rel=0.05)


@pytest.mark.parametrize("distance_m", [12.0, 45.0, 100.0])
def test_the_keep_out_counts_however_far_away_is_wanted(distance_m: float) -> None:
    settings = {
        "camera": {"pitch_deg": -27},
        "servo": {"target_size_m": PERSON_M, "distance_m": distance_m, "hold_height": True},
        "envelope": {"min_distance_m": 6.0},
    }
    walk = Walk(settings, hill(0.0, 0.0), speed_m_s=0.0, north_m=6.0)
    walk.go(2.0)
    assert walk.steering.servo.errors.least_range_m <= walk.ranges_m[-1] * 1.001
