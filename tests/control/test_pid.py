"""The PID loop against closed forms, and what it does when it is not obeyed."""

import math
from itertools import pairwise

import pytest

from follower_control.servo.pid import Pid, PidSettings

DT = 0.02


def run(pid: Pid, error: float, times: int, **options: float) -> list[float]:
    return [pid.update(error, 0.0, DT, **options) for _ in range(times)]


def test_proportional_gain_and_feed_forward_add_up():
    assert Pid(PidSettings(kp=2.0)).update(0.5, 0.0, DT, feed_forward=0.25) == pytest.approx(1.25)


def test_a_constant_error_integrates_to_gain_times_error_times_time():
    output = run(Pid(PidSettings(kp=0.0, ki=0.5)), 2.0, 100)
    assert output[-1] == pytest.approx(0.5 * 2.0 * 100 * DT)


def test_uneven_intervals_integrate_the_same():
    even, uneven = (Pid(PidSettings(kp=1.0, ki=0.5)) for _ in range(2))
    run(even, 1.0, 30)
    for interval in (0.01, 0.05, 0.03, 0.21, 0.3):
        uneven.update(1.0, 0.0, interval)
    assert even.integral == pytest.approx(uneven.integral)


def test_the_derivative_opposes_the_measurement_s_motion_and_settles_at_gain_times_rate():
    pid = Pid(PidSettings(kp=0.0, kd=0.4, derivative_filter_s=0.1))
    outputs = [pid.update(0.0, 3.0 * DT * i, DT) for i in range(100)]
    assert outputs[0] == 0.0
    assert outputs[-1] == pytest.approx(-0.4 * 3.0, rel=1e-3)


def test_a_new_wish_gives_no_derivative_kick():
    pid = Pid(PidSettings(kp=1.0, kd=5.0))
    assert [pid.update(error, 0.0, DT) for error in (0.0, 0.0, 1.0)] == [0.0, 0.0, 1.0]


def test_the_derivative_filter_has_the_time_constant_it_says():
    pid = Pid(PidSettings(kp=0.0, kd=1.0, derivative_filter_s=0.5))
    outputs = [pid.update(0.0, 0.001 * i, 0.001) for i in range(501)]
    assert outputs[-1] == pytest.approx(-(1 - math.exp(-1)), abs=0.01)


def test_outputs_stay_within_limits_and_the_integral_stops_there():
    pid = Pid(PidSettings(kp=1.0, ki=1.0), -0.5, 0.8)
    assert max(run(pid, 3.0, 500)) == 0.8
    assert pid.integral <= 3.0 * DT + 1e-9
    assert pid.update(-0.1, 0.0, DT) < 0.8


def test_it_comes_out_of_saturation_at_once_when_the_error_turns():
    pid = Pid(PidSettings(kp=1.0, ki=1.0), -1.0, 1.0)
    run(pid, 0.9, 500)
    assert pid.update(-0.9, 0.0, DT) < 0.15


@pytest.mark.parametrize("sign", [1, -1])
def test_what_is_not_allowed_is_not_integrated(sign):
    pid = Pid(PidSettings(kp=1.0, ki=1.0))
    pid.update(sign * 1.0, 0.0, DT)
    for _ in range(200):
        output = pid.update(sign * 1.0, 0.0, DT, saturation=sign * 0.5)
    assert abs(output) <= 1.0 + DT


def test_the_integral_gives_way_to_a_cut_but_never_past_zero():
    pid = Pid(PidSettings(kp=0.0, ki=1.0, tracking_s=0.5))
    run(pid, 1.0, 100)
    grown = pid.integral
    pid.update(0.0, 0.0, DT, saturation=1.0)
    assert pid.integral == pytest.approx(grown - DT / 0.5)
    run(pid, 0.0, 1000, saturation=1.0)
    assert pid.integral == 0.0


def test_an_error_that_leads_out_of_the_limit_is_integrated_even_while_cut():
    pid = Pid(PidSettings(kp=0.0, ki=1.0))
    pid.update(-1.0, 0.0, DT, saturation=0.5)
    assert pid.integral == pytest.approx(-DT)


def test_a_cut_within_tolerance_counts_as_none():
    tolerant, free = Pid(PidSettings(kp=0, ki=1, cut_tolerance=0.1)), Pid(PidSettings(kp=0, ki=1))
    assert run(tolerant, 1.0, 50, saturation=0.1)[-1] == run(free, 1.0, 50)[-1]


@pytest.mark.parametrize("settings", [PidSettings(kp=2.0), PidSettings(kp=2.0, ki=0.5, kd=0.3)])
def test_the_start_is_bumpless_and_the_bump_fades(settings):
    pid = Pid(settings)
    pid.start(present_output=-0.7)
    outputs = run(pid, 1.0, 300, feed_forward=0.1)
    assert outputs[0] == pytest.approx(-0.7)
    assert max(abs(b - a) for a, b in pairwise(outputs)) < 0.15
    assert outputs[-1] == pytest.approx(2.0 + 0.1 + pid.integral, abs=1e-4)


def test_starting_forgets():
    pid = Pid(PidSettings(kp=1.0, ki=1.0, kd=1.0))
    run(pid, 1.0, 50)
    pid.start()
    assert pid.update(1.0, 5.0, DT) == pytest.approx(1.0 + DT)


@pytest.mark.parametrize("interval", [0.0, -0.02, math.nan, math.inf])
def test_an_interval_that_is_not_positive_or_finite_is_refused(interval):
    with pytest.raises(ValueError, match=r"positive interval|finite"):
        Pid(PidSettings(kp=1.0)).update(1.0, 0.0, interval)


@pytest.mark.parametrize("name", ["error", "measurement", "feed_forward", "saturation"])
def test_numbers_that_are_not_finite_are_refused_and_leave_no_trace(name):
    pid, clean = Pid(PidSettings(kp=1, ki=1, kd=1)), Pid(PidSettings(kp=1, ki=1, kd=1))
    numbers = {"error": 1.0, "measurement": 0.0, "interval_s": DT}
    with pytest.raises(ValueError, match="finite"):
        pid.update(**(numbers | {name: math.nan}))
    assert pid.update(**numbers) == clean.update(**numbers)
