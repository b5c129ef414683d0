"""Looks are compared, and learnt for a search, only where something depends on them."""

from __future__ import annotations

import numpy as np
import pytest

from follower_vision.box import Box
from follower_vision.frame import Frame, Image
from follower_vision.fusion.belief import Belief
from follower_vision.fusion.following import Following
from follower_vision.fusion.looks import Looks
from follower_vision.fusion.settings import FusionSettings
from follower_vision.motion import MotionEstimate
from follower_vision.targetsearch import TargetSearch
from follower_vision.track import TrackState

BOX = Box(100, 80, 30, 30)
GROUND = np.random.default_rng(3).integers(0, 255, (160, 240, 3), np.uint8)
SETTINGS = FusionSettings()


class Unsure:
    """Stays where it is sent, as sure as it is told, and sees another place as sure as told."""

    name = "unsure"
    confidence = elsewhere = 1.0

    def start(self, _image: Image, box: Box) -> None:
        self._box = box

    def move_to(self, box: Box) -> None:
        self._box = box

    def update(self, _image: Image) -> MotionEstimate:
        return MotionEstimate(self._box, self.confidence)

    def probe(self, _image: Image, box: Box) -> list[MotionEstimate]:
        return [MotionEstimate(box, self.elsewhere)]


class CountingLooks(Looks):
    """Counts the comparisons."""

    compared = 0

    def score(self, image: Image, box: Box) -> float:
        self.compared += 1
        return super().score(image, box)


class Track:
    """A target that is followed through pictures in which nothing moves."""

    def __init__(self) -> None:
        self.motion, self.looks = Unsure(), CountingLooks(SETTINGS.reidentify)
        self.following = Following(self.motion, SETTINGS, self.looks)
        self.number = 0
        self.looks.start(self._frame(GROUND), BOX)
        self.following.start(self._frame(GROUND), BOX)
        self.belief = Belief(self._frame(GROUND), BOX, "unsure")

    def step(self, image: Image = GROUND) -> int:
        """Go on by a frame; return how often looks were compared in it."""
        self.number += 1
        before, frame = self.looks.compared, self._frame(image)
        expected = self.belief.advance(frame.captured_s, self.belief.now.total.back(), True)
        self.following.follow(frame, self.belief, expected, 1 / 30, False)
        return self.looks.compared - before

    def _frame(self, image: Image) -> Frame:
        return Frame(image, self.number / 30, self.number)


def test_a_coasting_track_is_looked_at_only_when_its_tracker_is_sure_again() -> None:
    track = Track()
    track.step()
    track.motion.confidence = 0.3
    track.step()
    track.step()
    assert track.belief.state is TrackState.COASTING
    assert [track.step() for _ in range(5)] == [0] * 5
    track.motion.confidence = 1.0
    assert track.step() == 1
    assert track.belief.state is TrackState.TRACKING


@pytest.mark.parametrize(("elsewhere", "compared"), [(1.0, 2), (0.8, 1)])
def test_another_place_is_looked_at_only_if_the_tracker_is_as_sure_of_it(
    elsewhere: float, compared: int
) -> None:
    track = Track()
    track.motion.elsewhere = elsewhere
    changed = np.full_like(GROUND, 90)
    track.step()
    while not track.following.doubting:
        track.step(changed)
        assert track.number < 10
    assert track.step(changed) == compared


def test_a_view_is_learnt_when_it_is_searched_for(monkeypatch: pytest.MonkeyPatch) -> None:
    learnt: list[Box] = []
    monkeypatch.setattr(TargetSearch, "learn", lambda _self, _image, box: learnt.append(box))
    looks, later = Looks(SETTINGS.reidentify), BOX.moved_to(104, 80)
    looks.start(Frame(GROUND, 0.0, 0), BOX)
    looks.learn(Frame(GROUND, 2.0, 60), later, 2.0)
    assert learnt == []
    looks.proposals(GROUND, BOX, 100.0)
    looks.proposals(GROUND, BOX, 100.0)
    assert learnt == [later]
