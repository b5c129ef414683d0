"""What is no number goes no further, and grows old."""

import math
from dataclasses import fields, replace

import pytest

from follower_control.vehicle.stale_data import FiniteTelemetryFilter
from follower_control.vehicle.state import Attitude, LocalPosition, VehicleState

ATTITUDE = Attitude(0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 5.0)
POSITION = LocalPosition(1.0, 2.0, -3.0, 0.0, 0.0, 0.0, 5.0)
SOUND = VehicleState(ATTITUDE, POSITION, "GUIDED", True, True, False, 5.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", [field.name for field in fields(Attitude)])
def test_an_attitude_that_is_no_number_is_the_one_before(name: str, bad: float) -> None:
    sound = FiniteTelemetryFilter()
    assert sound.of(SOUND) is SOUND
    attitude = replace(replace(ATTITUDE, time_s=6.0), **{name: bad})
    broken = replace(SOUND, attitude=attitude, heartbeat_s=6.0)
    kept = sound.of(broken)
    assert kept == replace(SOUND, heartbeat_s=6.0)
    assert kept.attitude_age_s(6.0) == 1.0


def test_a_position_that_is_no_number_is_the_one_before() -> None:
    sound = FiniteTelemetryFilter()
    sound.of(SOUND)
    newer = replace(ATTITUDE, time_s=6.0)
    broken = replace(SOUND, attitude=newer, position=replace(POSITION, down_m=math.nan))
    assert sound.of(broken) == replace(SOUND, attitude=newer)


def test_before_the_first_sound_one_there_is_none() -> None:
    broken = replace(SOUND, attitude=replace(ATTITUDE, roll_rad=math.nan))
    assert FiniteTelemetryFilter().of(broken) == replace(SOUND, attitude=None)
