"""How fast a target below may be closed in on, and the speed after an unseen target."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_control.servo.output_blend import fastest_closing_m_s, slowed
from follower_control.vehicle.setpoint import VelocitySetpoint

BELOW = math.radians(-25)


def test_closing_in_so_fast_with_that_sinking_keeps_the_elevation() -> None:
    closing = fastest_closing_m_s(BELOW, 0.0, 20.0, 1.2)
    level, height = 20.0 * math.cos(BELOW), -20.0 * math.sin(BELOW)
    assert math.atan2(height - 1.2, level - closing) == pytest.approx(-BELOW)


def test_a_target_that_is_seen_too_low_comes_first() -> None:
    free, low, lower = (
        fastest_closing_m_s(BELOW, math.radians(error_deg), 20.0, 1.2) for error_deg in (0, -3, -20)
    )
    assert 0 == lower < low < free
    assert fastest_closing_m_s(BELOW, math.radians(3), 20.0, 1.2) == free, "one too high does not"


@pytest.mark.parametrize("elevation_deg", [0, 30, -0.5])
def test_a_target_that_is_not_below_is_closed_in_on_at_any_speed(elevation_deg: float) -> None:
    assert fastest_closing_m_s(math.radians(elevation_deg), -0.5, 20.0, 1.0) == math.inf


@given(st.floats(-math.pi / 2, math.pi / 2), st.floats(-3, 3), st.floats(0.1, 500), st.floats(0, 9))
def test_it_is_never_negative_and_a_number(
    elevation: float, error: float, range_m: float, sink_m_s: float
) -> None:
    assert fastest_closing_m_s(elevation, error, range_m, sink_m_s) >= 0


ASKED = VelocitySetpoint(6.0, -2.0, 1.0, 0.5)


def test_a_blink_costs_no_speed_and_the_end_of_the_coast_all_of_it() -> None:
    assert slowed(ASKED, 0.4, 0.8) == ASKED
    assert slowed(ASKED, 0.6, 0.8).values == pytest.approx((3.0, -1.0, 0.5, 0.5))
    for unseen_s in (0.8, 5.0, float("inf")):
        assert slowed(ASKED, unseen_s, 0.8).values == pytest.approx((0.0, 0.0, 0.0, 0.5))


@given(st.floats(0, 2), st.floats(0, 0.01))
def test_the_speed_falls_and_never_jumps(unseen_s: float, later_s: float) -> None:
    before, after = (slowed(ASKED, at, 1.0).forward_m_s for at in (unseen_s, unseen_s + later_s))
    assert before - 6.0 * 3.1 * later_s - 1e-9 <= after <= before + 1e-9
