"""The filter that predicts the target's box: what holds for any box, time and noise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import strategies as st

from follower_vision.fusion.box_filter import BoxFilter, FilterNoise
from follower_vision.fusion.candidates import SOURCES
from follower_vision.geometry.box import Box

FADE_S = 0.7
MANOEUVRE, GROWTH, PLACE, SIZE = 5.0, 0.3, 0.06, 0.09
NOISE = FilterNoise(MANOEUVRE, GROWTH, dict.fromkeys(SOURCES, PLACE), dict.fromkeys(SOURCES, SIZE))
PLACES, SIDES = st.floats(0, 640), st.floats(4, 300)
BOXES = st.builds(Box, PLACES, PLACES, SIDES, SIDES)
INTERVALS = st.floats(1e-3, 1.0)
PROBABILITIES = st.floats(0.05, 1.0)


def steady(
    frames: int = 60, px: float = 3.0, scale: float = 1.0, rate_hz: float = 30.0
) -> BoxFilter:
    """A filter that has seen a target go right by so many pixels a frame."""
    kalman = BoxFilter(NOISE, Box(100 * scale, 100 * scale, 20 * scale, 30 * scale))
    for number in range(1, frames + 1):
        kalman.predict(1 / rate_hz)
        place = (100 + px * number) * scale
        kalman.observe(Box(place, 100 * scale, 20 * scale, 30 * scale), "peak", 1.0)
    return kalman


@given(BOXES, BOXES, st.lists(INTERVALS, min_size=1, max_size=10), PROBABILITIES)
def test_uncertainty_grows_in_a_prediction_and_shrinks_in_an_observation(
    first: Box, later: Box, intervals_s: list[float], probability: float
) -> None:
    kalman = BoxFilter(NOISE, first)
    for interval_s in intervals_s:
        before = kalman.deviations
        kalman.predict(interval_s)
        predicted = kalman.deviations
        assert np.all(predicted > before)
        kalman.observe(later, "peak", probability)
        assert np.all(kalman.deviations < predicted)
        assert np.all(kalman.deviations > 0)


@given(BOXES, BOXES, PROBABILITIES, PROBABILITIES)
def test_the_more_probable_an_observation_the_more_it_counts(
    first: Box, later: Box, one: float, other: float
) -> None:
    distances = []
    for probability in sorted((one, other)):
        kalman = BoxFilter(NOISE, first)
        kalman.predict(0.1)
        kalman.observe(later, "peak", probability)
        distances.append(kalman.box.distance(later))
    assert distances[1] <= distances[0] + 1e-9


@given(st.lists(st.tuples(INTERVALS, st.floats(50, 150), PROBABILITIES), min_size=1, max_size=12))
def test_each_axis_is_a_kalman_filter_of_a_value_and_a_fading_rate(
    observed: list[tuple[float, float, float]],
) -> None:
    """Sizes do not change here, so a place's noise is the same number of pixels all the time."""
    side = 20.0
    ours, theirs = BoxFilter(NOISE, Box(100, 80, side, side)), KalmanFilter(2, 1)
    theirs.x, theirs.H = np.array([[100.0], [0.0]]), np.array([[1.0, 0.0]])
    theirs.P = np.diag([(0.03 * side) ** 2, (3.0 * side) ** 2])
    for interval_s, place, probability in observed:
        fade = math.exp(-interval_s / FADE_S)
        power = (MANOEUVRE * side) ** 2 * interval_s
        theirs.F = np.array([[1.0, FADE_S * (1 - fade)], [0.0, fade]])
        theirs.Q = power * np.array([[interval_s**2 / 3, interval_s / 2], [interval_s / 2, 1.0]])
        theirs.R = np.array([[(PLACE * side / probability) ** 2]])
        theirs.predict()
        theirs.update(np.array([[place]]))
        ours.predict(interval_s)
        ours.observe(Box(place, 80, side, side), "peak", probability)
        assert ours.box.cx == pytest.approx(theirs.x[0, 0], rel=1e-6)
        assert ours.deviations[0] == pytest.approx(math.sqrt(theirs.P[0, 0]), rel=1e-6)
        assert ours.box.cy == pytest.approx(80)
        assert ours.box.scale == pytest.approx(side)


@given(st.floats(0.2, 8.0), st.floats(-4, 4))
def test_near_and_far_targets_are_filtered_alike(scale: float, px: float) -> None:
    usual, other = steady(10, px), steady(10, px, scale)
    assert other.box.cx == pytest.approx(scale * usual.box.cx, rel=1e-6)
    assert other.box.scale == pytest.approx(scale * usual.box.scale, rel=1e-6)
    assert other.spread == pytest.approx(usual.spread, rel=1e-6)
    assert other.speed == pytest.approx(usual.speed, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("interval_s", [0.01, 0.1, 0.7])
def test_unseen_the_velocity_fades_however_often_it_is_predicted(interval_s: float) -> None:
    kalman = steady()
    start, speed = kalman.box, kalman.speed
    for _ in range(round(1.4 / interval_s)):
        kalman.predict(interval_s)
    fade = math.exp(-1.4 / FADE_S)
    assert kalman.speed == pytest.approx(speed * fade)
    way = FADE_S * (1 - fade) * speed * start.scale
    assert kalman.box.cx - start.cx == pytest.approx(way)


def test_a_steady_target_is_predicted_where_it_comes() -> None:
    kalman = steady(60, 3.0)
    last = kalman.box
    kalman.predict(1 / 30)
    assert kalman.box.cx - last.cx == pytest.approx(3.0, abs=0.5)


@pytest.mark.parametrize("rate_hz", [10.0, 30.0, 120.0])
def test_the_speed_is_known_in_sizes_a_second_at_any_rate_of_frames(rate_hz: float) -> None:
    speed_px_s = 60.0
    kalman = steady(round(2 * rate_hz), speed_px_s / rate_hz, rate_hz=rate_hz)
    assert kalman.speed * kalman.box.scale == pytest.approx(speed_px_s, rel=0.15)


def test_what_is_expected_by_other_knowledge_moves_the_centre_alone() -> None:
    kalman = steady()
    before = kalman.box
    kalman.predict(0.1)
    size = kalman.box.scale
    kalman.expect(before.cx, before.cy + 50, 1e-6)
    assert (kalman.box.cx, kalman.box.cy) == pytest.approx((before.cx, before.cy + 50))
    assert kalman.box.scale == pytest.approx(size)


def test_placed_anew_nothing_of_the_way_is_left() -> None:
    kalman, place = steady(), Box(300, 200, 40, 40)
    kalman.place_at(place)
    assert kalman.speed == 0
    kalman.predict(0.5)
    assert kalman.box.distance(place) == 0


@given(BOXES, st.floats(-2000, 2000), st.floats(-2000, 2000), SIDES)
def test_the_centre_stays_on_the_image_and_the_size_sensible(
    first: Box, right: float, down: float, side: float
) -> None:
    kalman = BoxFilter(NOISE, first)
    for _ in range(5):
        kalman.predict(0.2)
        kalman.observe(Box(right, down, side, side), "peak", 1.0)
        kalman.keep_within(640, 480)
        box = kalman.box
        assert 0 <= box.cx <= 640
        assert 0 <= box.cy <= 480
        assert 2.0 <= box.width * (1 + 1e-9) <= 1281
        assert 2.0 <= box.height * (1 + 1e-9) <= 961


def test_kept_at_the_edge_it_does_not_go_on_leaving() -> None:
    kalman = steady(60, 10.0)
    kalman.keep_within(320, 240)
    assert kalman.box.cx == 320
    assert kalman.speed == pytest.approx(0, abs=1e-6)
