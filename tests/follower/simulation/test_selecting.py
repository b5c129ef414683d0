"""How a target is pointed out by its colour, alone or among its likes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from follower.flight.target.selectors import colour_selector
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame

RED = "#d02020"
SMALL, LARGE = Box(60, 90, 24, 20), Box(200, 90, 44, 40)


@pytest.fixture
def frame() -> Frame:
    """A small and a large red thing on green ground."""
    image = np.full((180, 260, 3), (60, 110, 70), np.uint8)
    for box in (SMALL, LARGE):
        corner = round(box.left), round(box.top)
        cv2.rectangle(
            image, corner, (round(box.right) - 1, round(box.bottom) - 1), (32, 32, 208), -1
        )
    return Frame(image, 0.0, 0)


def test_by_its_colour_alone_the_larger_one_is_meant(frame: Frame) -> None:
    chosen = colour_selector(RED)(frame)
    assert chosen.iou(LARGE) > 0.7


@pytest.mark.parametrize("meant", [SMALL, LARGE])
def test_who_points_gets_what_is_pointed_at(frame: Frame, meant: Box) -> None:
    place = meant.moved_to(meant.cx + 6, meant.cy - 5)
    chosen = colour_selector(RED, pointed=lambda _: place)(frame)
    assert chosen.iou(meant) > 0.7


@pytest.mark.parametrize("place", [None, Box(130, 40, 24, 20)], ids=["nowhere", "at nothing"])
def test_nothing_is_chosen_while_nobody_points_at_anything_red(
    frame: Frame, place: Box | None
) -> None:
    assert colour_selector(RED, pointed=lambda _: place)(frame) is None
