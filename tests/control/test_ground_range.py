"""No target is farther away than where the line of sight meets the ground."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from follower_control.target.estimate import TargetEstimate, range_to_ground, ranged_by_ground
from follower_control.target.observation import BearingFrame


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


def standing_on_the_ground(height: float, away: float, closing: float, climb: float, t: float):
    """An estimate of a target 0.8 m high, from a vehicle that moves for a time t."""
    h, d = height + climb * t - 0.8, away - closing * t
    return TargetEstimate(
        time_s=t,
        azimuth_rad=0.3,
        elevation_rad=-math.atan2(h, d),
        log_scale=0.0,
        azimuth_rate_rad_s=0.0,
        elevation_rate_rad_s=-(climb * d + closing * h) / (h * h + d * d),
        log_scale_rate_s=0.0,
        covariance=np.eye(6),
        last_seen_s=t,
        frame=BearingFrame.WORLD,
    )


@given(st.floats(3, 40), st.floats(3, 25), st.floats(-5, 5), st.floats(-1, 1))
def test_by_the_ground_the_range_and_its_rate_are_those_of_geometry(
    height: float, away: float, closing: float, climb: float
) -> None:
    def seen(t: float) -> TargetEstimate:
        estimate = standing_on_the_ground(height, away, closing, climb, t)
        return ranged_by_ground(estimate, 2.0, height + climb * t - 0.8, climb)

    true = math.hypot(away, height - 0.8)
    assert 2.0 * math.exp(-seen(0.0).log_scale) == pytest.approx(true)
    slope = (seen(1e-4).log_scale - seen(-1e-4).log_scale) / 2e-4
    assert seen(0.0).log_scale_rate_s == pytest.approx(slope, abs=1e-5)


@pytest.mark.parametrize("away", [200.0, 0.5])
def test_along_a_flat_line_or_too_low_the_size_counts(away: float) -> None:
    estimate = standing_on_the_ground(5.0 if away > 1 else 1.2, away, 0.0, 0.0, 0.0)
    above = 4.2 if away > 1 else 0.4
    flat = replace(estimate, log_scale=-1.5)
    assert (ranged_by_ground(flat, 2.0, above, 0.0) is flat) == (away > 1 or above < 1)


@given(st.floats(-7.0, 7.0), st.floats(-5.0, 50.0))
def test_a_prediction_that_has_passed_below_us_is_straight_down_and_never_behind(
    elevation: float, height: float
) -> None:
    assert range_to_ground(height, elevation) > 0
    seen = replace(standing_on_the_ground(10.0, 10.0, 1.0, 0.0, 0.0), elevation_rad=elevation)
    ranged = ranged_by_ground(seen, 2.0, height, 0.5)
    assert math.isfinite(ranged.log_scale)
    if elevation <= -math.pi / 2 and height >= 1.0:
        assert 2.0 / math.exp(ranged.log_scale) == pytest.approx(height)
