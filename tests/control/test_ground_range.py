"""No target is farther away than where the line of sight meets the ground."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_control.ground_range import range_to_ground


@given(st.floats(1.0, 100.0), st.floats(-89.0, -5.1), st.floats(0.0, 1.0))
def test_a_target_on_or_above_level_ground_is_never_taken_for_farther(
    height: float, elevation_deg: float, share: float
) -> None:
    elevation = math.radians(elevation_deg)
    true_range = share * height / math.sin(-elevation)
    assert range_to_ground(height, elevation) >= true_range


@given(st.floats(1.0, 100.0), st.floats(-89.0, -5.1))
def test_the_bound_is_no_more_than_a_quarter_too_far(height: float, elevation_deg: float) -> None:
    elevation = math.radians(elevation_deg)
    on_the_ground = height / math.sin(-elevation)
    assert range_to_ground(height, elevation) == pytest.approx(1.25 * on_the_ground)


@pytest.mark.parametrize(("height", "elevation_deg"), [(0.5, -40), (-2, -40), (20, -4), (20, 30)])
def test_nothing_is_said_near_the_ground_or_along_a_flat_line(
    height: float, elevation_deg: float
) -> None:
    assert range_to_ground(height, math.radians(elevation_deg)) == math.inf
