"""Fusion's gaze: how a motion tracker is put right."""

from __future__ import annotations

import numpy as np
import pytest

from follower_vision.box import Box
from follower_vision.frame import Frame
from follower_vision.fusion.gaze import Gaze
from follower_vision.fusion.settings import FusionSettings
from follower_vision.motion import MotionEstimate

FRAME = Frame(np.zeros((48, 64, 3), np.uint8), 0.0, 0)
BOX = Box(20, 20, 10, 10)


class Following:
    """Writes down what it is told."""

    name = "following"

    def __init__(self) -> None:
        self.told: list[str] = []

    def start(self, _image, _box) -> None:
        self.told.append("start")

    def update(self, _image) -> MotionEstimate:
        return MotionEstimate(BOX, 1.0)


class Steered(Following):
    def move_to(self, _box) -> None:
        self.told.append("move_to")


class Corrected(Steered):
    def correct(self, _image, _box) -> None:
        self.told.append("correct")


@pytest.mark.parametrize(
    ("motion", "told"), [(Following(), "start"), (Steered(), "move_to"), (Corrected(), "correct")]
)
def test_it_is_put_right_by_as_little_as_it_understands(motion: Following, told: str) -> None:
    Gaze(motion, FusionSettings()).turn_to(FRAME, BOX)
    assert motion.told == [told]


@pytest.mark.parametrize("motion", [Following(), Steered(), Corrected()])
def test_in_the_papers_way_it_learns_anew(motion: Following) -> None:
    Gaze(motion, FusionSettings().without("keep_template")).turn_to(FRAME, BOX)
    assert motion.told == ["start"]
