"""Attitudes of the past, by interpolation, and of the very near future."""

import math
from dataclasses import replace

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from follower_control.vehicle.history import AttitudeHistory, turned_on
from follower_control.vehicle.state import Attitude
from follower_vision.geometry.line_of_sight import rotation, wrap_angle

LEVEL = Attitude(0, 0, 0, 0, 0, 0, 0)


def at(time_s: float, yaw_deg: float = 0.0, **others: float) -> Attitude:
    return replace(LEVEL, time_s=time_s, yaw_rad=math.radians(yaw_deg), **others)


def history(*samples: Attitude) -> AttitudeHistory:
    made = AttitudeHistory()
    assert all(made.add(sample) for sample in samples)
    return made


def test_it_interpolates_between_neighbours():
    found = history(at(1.0, 10, pitch_rad=0.1), at(1.1, 20, pitch_rad=0.2)).at(1.025)
    assert math.degrees(found.yaw_rad) == pytest.approx(12.5)
    assert found.pitch_rad == pytest.approx(0.125)
    assert found.time_s == 1.025


def test_a_sample_is_found_again_exactly():
    samples = [at(0.02 * i, 3 * i) for i in range(20)]
    found = history(*samples).at(samples[7].time_s)
    assert found.yaw_rad == pytest.approx(samples[7].yaw_rad, abs=1e-12)


@given(st.floats(-180, 180), st.floats(-90, 90), st.floats(0, 1))
def test_yaw_goes_the_short_way_round(start_deg, turn_deg, share):
    past = history(at(0.0, start_deg), at(0.1, start_deg + turn_deg))
    found = past.at(0.1 * share)
    expected = math.radians(start_deg + share * turn_deg)
    assert wrap_angle(found.yaw_rad - expected) == pytest.approx(0, abs=1e-9)
    assert -math.pi <= found.yaw_rad < math.pi or share in (0, 1)


def test_after_the_newest_the_body_rates_count_but_not_for_long():
    past = history(at(5.0, 179, yaw_rate_rad_s=math.radians(30)))
    assert math.degrees(past.at(5.1).yaw_rad) == pytest.approx(-178)
    assert past.at(5.11) is None


def test_before_the_oldest_and_in_a_gap_nothing_is_known():
    past = history(at(1.0), at(1.1), at(3.0))
    assert past.at(0.99) is None
    assert past.at(2.0) is None
    assert past.at(1.05) is not None


@pytest.mark.parametrize("time_s", [math.nan, math.inf, -math.inf])
def test_no_time_no_attitude(time_s):
    assert history(at(1.0)).at(time_s) is None


def test_an_empty_history_knows_nothing():
    assert AttitudeHistory().at(0.0) is None


@pytest.mark.parametrize(
    "bad",
    [at(1.0), at(0.5), at(math.nan), at(2.0, math.nan), at(2.0, roll_rate_rad_s=math.inf)],
    ids=["repeated", "older", "no time", "no yaw", "infinite rate"],
)
def test_it_refuses_what_is_old_or_not_finite_and_keeps_what_it_has(bad):
    past = history(at(0.9), at(1.0))
    assert not past.add(bad)
    assert len(past) == 2
    assert past.at(0.95) is not None


def test_memory_is_bounded_and_forgets_the_oldest():
    past = history(*(at(0.002 * i) for i in range(2000)))
    assert past.at(0.9) is None
    assert past.at(1.1) is not None  # 3 s, however many samples that are
    assert len(past) < 1510


def test_after_clearing_time_may_begin_anew():
    past = history(at(100.0))
    past.clear()
    assert past.add(at(1.0))


@given(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(-3, 3), *[st.floats(-1.5, 1.5)] * 3)
def test_turning_on_agrees_with_the_rotation_matrix_s_own_derivative(roll, pitch, yaw, p, q, r):
    step = 1e-4
    after = turned_on(Attitude(roll, pitch, yaw, p, q, r, 0.0), step)
    spin = np.array([[0, -r, q], [r, 0, -p], [-q, p, 0]])
    expected = rotation(roll, pitch, yaw) @ (np.eye(3) + step * spin)
    turned = rotation(after.roll_rad, after.pitch_rad, after.yaw_rad)
    np.testing.assert_allclose(turned, expected, atol=1e-6)
