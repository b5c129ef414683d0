"""Nudges shift what is wanted: smoothly, within bounds, and are taken back as smoothly."""

import math
from dataclasses import replace

import hypothesis.strategies as st
import pytest
from hypothesis import given

from follower_control.servo.output_blend import NO_OFFSET, StickOffset
from follower_control.servo.pursuit_state import ANGLE_RAD_S, DISTANCE_M_S, SIDE_M_S2, Reference

DISTANCE, ELEVATION = 12.0, math.radians(-25)
number = st.floats(allow_nan=True, allow_infinity=True)
nudges = st.builds(StickOffset, number, number, number, number)


def values(reference: Reference) -> tuple[float, float, float, float]:
    return (
        reference.distance_m,
        reference.elevation_rad,
        reference.azimuth_rad,
        reference.side_m_s,
    )


def test_without_a_nudge_it_is_what_the_settings_say_to_the_last_bit() -> None:
    reference = Reference(DISTANCE, ELEVATION)
    for _ in range(50):
        reference.step(0.02)
    assert values(reference) == (DISTANCE, ELEVATION, 0.0, 0.0)


def test_a_nudge_is_reached_and_taken_back() -> None:
    reference = Reference(DISTANCE, ELEVATION)
    reference.set_offset(StickOffset(3.0, 0.2, -0.1, 1.5))
    for _ in range(200):
        reference.step(0.02)
    assert values(reference) == pytest.approx((DISTANCE + 3, ELEVATION + 0.2, -0.1, 1.5))
    reference.set_offset(NO_OFFSET)
    for _ in range(200):
        reference.step(0.02)
    assert values(reference) == (DISTANCE, ELEVATION, 0.0, 0.0)


@given(st.lists(st.tuples(nudges, st.floats(0, 0.5)), max_size=20))
def test_any_nudges_move_it_no_faster_than_it_may_go(
    steps: list[tuple[StickOffset, float]],
) -> None:
    reference = Reference(DISTANCE, ELEVATION)
    for nudge, interval_s in steps:
        before = values(reference)
        reference.set_offset(nudge)
        reference.step(interval_s)
        rates = (DISTANCE_M_S, ANGLE_RAD_S, ANGLE_RAD_S, SIDE_M_S2)
        for old, new, rate in zip(before, values(reference), rates, strict=True):
            assert abs(new - old) <= rate * interval_s + 1e-9
        assert reference.distance_m >= DISTANCE / 4
        assert abs(reference.elevation_rad) <= math.radians(85)


@pytest.mark.parametrize("name", ["distance_m", "elevation_rad", "azimuth_rad", "side_m_s"])
def test_a_nudge_that_is_no_number_is_none(name: str) -> None:
    reference = Reference(DISTANCE, ELEVATION)
    reference.set_offset(replace(StickOffset(1.0, 0.1, 0.1, 1.0), **{name: math.nan}))
    reference.step(0.1)
    assert values(reference) == (DISTANCE, ELEVATION, 0.0, 0.0)
