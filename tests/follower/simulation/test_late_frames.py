"""A flight in real time says so if the computer was too slow for it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from follower.flight.log import FlightLog, TrackRecord
from follower.simulation.run import late_control_warning, late_frame_warning


def log_of(captured_s: list[float]) -> FlightLog:
    log = FlightLog()
    for number, time_s in enumerate(captured_s):
        log.add_track(TrackRecord(None, number, time_s, time_s + 0.05, time_s + 0.06, 0.01))
    return log


def test_nothing_is_said_of_vision_that_keeps_up() -> None:
    assert late_frame_warning(log_of(list(np.arange(0, 10, 1 / 28))), 30) is None
    assert late_frame_warning(log_of([1.0]), 30) is None


def test_too_few_frames_are_told_with_their_rate() -> None:
    said = late_frame_warning(log_of(list(np.arange(0, 10, 1 / 15))), 30)
    assert said is not None
    assert "15 of the camera's 30 frames a second" in said
    assert "--lockstep" in said


@pytest.mark.parametrize("gap_s", [0.5, 1.9])
def test_a_gap_is_told_however_many_frames_there_were(gap_s: float) -> None:
    before = list(np.arange(0, 10, 1 / 30))
    after = [before[-1] + gap_s + number / 30 for number in range(300)]
    said = late_frame_warning(log_of(before + after), 30)
    assert said is not None
    assert f"gaps of up to {gap_s:.1f} s" in said


def test_control_that_is_too_slow_is_told_with_what_a_step_takes(fly: Any) -> None:
    flown = fly()
    assert late_control_warning(FlightLog(), 50) is None
    assert late_control_warning(flown.log, 50) is None
    slow = FlightLog()
    for number, record in enumerate(flown.log.controls):
        slow.add_control(replace(record, time_s=0.1 * number, busy_s=0.1))
    said = late_control_warning(slow, 50)
    assert said is not None
    assert "10 of the wanted 50 steps a second" in said
    assert "100.0 ms" in said
