"""The range loop's gains go with the wanted distance: as robust near as far, and without a step."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_control.envelope.settings import EnvelopeSettings
from follower_control.servo.output_blend import StickOffset
from follower_control.servo.pid import Pid, PidSettings
from follower_control.servo.servo import VisualServo
from follower_control.servo.settings import ServoSettings
from follower_control.target.estimate import TargetEstimate
from follower_control.target.observation import BearingFrame
from follower_control.target.settings import EstimatorSettings
from follower_control.tuning.axes import Axis, LoopSettings, axis_loop
from follower_control.tuning.axis_loop import Conditions
from follower_control.tuning.response_model import ResponseModel, VehicleModel
from follower_control.vehicle.setpoint import HOLD
from follower_control.vehicle.state import VehicleState

ANSWER = ResponseModel(1.0, 0.2, 0.4)
VEHICLE = VehicleModel(ANSWER, ANSWER, ANSWER, ANSWER)
STEP_S = 0.02


def loop_at(range_m: float, schedule: bool):
    servo = ServoSettings(distance_m=16.0, schedule_range=schedule)
    follower = LoopSettings(servo, EstimatorSettings(), EnvelopeSettings())
    return axis_loop(Axis.RANGE, servo.range, VEHICLE, follower, Conditions(range_m=range_m))


def test_without_a_schedule_the_margins_are_thin_at_a_quarter_of_the_distance() -> None:
    standing = replace(loop_at(16.0, False), shortfall=None)
    assert standing.margins().gain > 2.0
    assert not loop_at(4.0, False).is_stable() or loop_at(4.0, False).margins().gain < 1.6


@pytest.mark.parametrize("range_m", [4.0, 8.0, 16.0, 40.0])
def test_with_it_the_loop_is_about_as_robust_at_every_distance(range_m: float) -> None:
    here, there = loop_at(16.0, True).margins(), loop_at(range_m, True).margins()
    assert loop_at(range_m, True).is_stable()
    assert there.gain > 0.85 * here.gain
    assert there.max_sensitivity < 1.15 * here.max_sensitivity


def estimate(now_s: float, range_m: float) -> TargetEstimate:
    return TargetEstimate(
        now_s, 0.0, 0.0, math.log(2.0 / range_m), 0, 0, 0, np.eye(6), now_s, BearingFrame.BODY
    )


def flown(servo: VisualServo, ranges_m: list[float], nudges: dict[int, StickOffset]) -> list[float]:
    asked, allowed = [], HOLD
    for i, range_m in enumerate(ranges_m):
        if i in nudges:
            servo.set_offset(nudges[i])
        allowed = servo.update(estimate(i * STEP_S, range_m), VehicleState(), allowed)
        asked.append(allowed.forward_m_s)
    return asked


def test_without_a_nudge_it_changes_no_bit() -> None:
    ranges = [18.0 - 0.01 * i + 0.3 * math.sin(0.1 * i) for i in range(300)]
    each = [
        flown(VisualServo(ServoSettings(target_size_m=2.0, schedule_range=on)), ranges, {})
        for on in (True, False)
    ]
    assert each[0] == each[1]


def test_a_nudge_near_changes_the_setpoint_without_a_step() -> None:
    settings = ServoSettings(target_size_m=2.0, distance_m=16.0)
    # The distance goes from 16 m to 4 m at 2 m/s, and the vehicle with it, half a metre behind.
    ranges = [max(16.5 - max(0.0, i * STEP_S - 1.0) * 2.0, 4.1) for i in range(500)]
    asked = flown(VisualServo(settings), ranges, {50: StickOffset(distance_m=-12.0)})
    assert np.abs(np.diff(asked[2:])).max() < 0.15


def test_at_a_nudged_distance_the_same_error_in_metres_asks_for_about_the_same() -> None:
    asked = []
    for distance_m, nudge in ((16.0, StickOffset(distance_m=-12.0)), (16.0, StickOffset())):
        gains = PidSettings(kp=0.5, kd=0.3)  # an integral remembers the way there
        servo = VisualServo(ServoSettings(target_size_m=2.0, distance_m=distance_m, range=gains))
        wanted = distance_m + nudge.distance_m
        asked.append(flown(servo, [wanted + 0.2] * 600, {0: nudge})[-1])
    assert asked[0] == pytest.approx(asked[1], rel=0.1)


@given(gain=st.floats(0.1, 10), error=st.floats(-1, 1), rate=st.floats(-1, 1))
def test_a_gain_in_the_call_is_a_gain_in_the_settings(
    gain: float, error: float, rate: float
) -> None:
    settings = PidSettings(kp=0.7, ki=0.2, kd=0.3)
    more = replace(settings, kp=gain * 0.7, ki=gain * 0.2, kd=gain * 0.3)
    one, other = Pid(settings), Pid(more)
    for i in range(20):
        asked = one.update(error, rate * i * STEP_S, STEP_S, gain=gain)
        assert asked == pytest.approx(other.update(error, rate * i * STEP_S, STEP_S), abs=1e-9)


def test_a_change_of_settings_with_the_gain_that_comes_makes_no_step() -> None:
    loop = Pid(PidSettings(kp=1.0))
    before = loop.update(0.5, 0.0, STEP_S, gain=0.25)
    loop.change(PidSettings(kp=3.0), gain=0.5)
    assert loop.update(0.5, 0.0, STEP_S, gain=0.5) == pytest.approx(before, abs=0.06)
