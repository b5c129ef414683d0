"""The speed after an unseen target."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_control.servo.output_blend import slowed
from follower_control.vehicle.setpoint import VelocitySetpoint

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
