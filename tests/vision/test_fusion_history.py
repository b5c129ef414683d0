"""The camera's motion between frames stays right however long a flight goes on."""

from __future__ import annotations

import math

import pytest

from follower_vision.box import Box
from follower_vision.fusion.history import History, Moment
from follower_vision.fusion.warp import Warp

BOX = Box(320, 240, 40, 40)
CENTRE = (320.0, 240.0)


def zoomed(zoom: float, turn: float = 0.0) -> Warp:
    """A motion that makes things larger about the image's middle, and turns them."""
    cosine, sine = zoom * math.cos(turn), zoom * math.sin(turn)
    x, y = CENTRE
    return Warp(cosine, sine, x - cosine * x + sine * y, y - sine * x - cosine * y)


def flown(step: Warp, frames: int) -> tuple[History, list[Moment]]:
    history = History()
    return history, [history.add(number / 30, step, BOX) for number in range(frames)]


@pytest.mark.parametrize("zoom", [1.005, 0.995], ids=["forward", "backward"])
@pytest.mark.parametrize("turn", [0.0, 0.02])
def test_ten_frames_apart_are_ten_single_motions_apart_after_minutes_too(
    zoom: float, turn: float
) -> None:
    step = zoomed(zoom, turn)
    ten = Warp()
    for _ in range(10):
        ten = ten.then(step)
    history, moments = flown(step, 10_000)
    for number in range(10, 10_000, 97):
        motion = history.warp(moments[number - 10], moments[number])
        back = history.warp(moments[number], moments[number - 10])
        for point in [(0.0, 0.0), (640.0, 0.0), (500.0, 400.0)]:
            assert motion.point(*point) == pytest.approx(ten.point(*point), abs=1e-5)
            assert back.point(*motion.point(*point)) == pytest.approx(point, abs=1e-5)


def test_a_frame_is_nowhere_but_where_it_is() -> None:
    history, moments = flown(zoomed(1.008), 6_000)
    now = moments[-1]
    assert history.warp(now, now).point(100.0, 50.0) == pytest.approx((100.0, 50.0), abs=1e-6)


def test_the_motion_since_long_ago_is_finite_after_half_an_hour() -> None:
    history, moments = flown(zoomed(1.01), 54_000)
    motion = history.warp(moments[0], moments[-1])
    assert all(math.isfinite(value) for value in motion.point(10.0, 10.0))
    assert all(math.isfinite(value) for value in motion.back().point(10.0, 10.0))
