"""Several targets, one detector."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from follower_vision.detection.detection import Detection
from follower_vision.fusion import FusionSettings, MultiFusion
from follower_vision.fusion.candidates import corners_of
from follower_vision.fusion.model import CandidateModel
from follower_vision.fusion.multi import MOST_TARGETS
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.trackers.motion_tracker import MotionEstimate, ResponseMap
from follower_vision.trackers.track import TrackState

NOISE = np.random.default_rng(6).integers(0, 120, (45, 480, 640, 3), np.uint8)
SIDE = 30
Places = list[tuple[float, float]]
Make = Callable[..., MultiFusion]


class SquareDetector:
    """Finds white squares, in the region asked for."""

    class_names = ("square",)

    def __init__(self) -> None:
        self.looks = 0

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
        self.looks += 1
        boxes = squares(image)
        return [
            Detection(box, 0, "square", 0.9)
            for box in boxes
            if region is None or region.intersection(box) > 0
        ]


class SquareTracker:
    """Answers with the square nearest to where it searches."""

    name = "squares"

    def start(self, image: Image, box: Box) -> None:
        """There is nothing to learn."""

    def update(self, image: Image) -> MotionEstimate:
        raise NotImplementedError(f"Fusion searches; nobody asks for {image.shape}")

    def search(self, image: Image, box: Box) -> ResponseMap:
        near = [one for one in squares(image) if one.distance(box) < 3 * SIDE]
        found = near or [box]
        scores = np.full(len(found), 0.95 if near else 0.0)
        return ResponseMap(corners_of(found), scores, np.ones(len(found)), box.scaled(4))

    def learn(self, image: Image, box: Box, probability: float) -> None:
        """There is nothing to learn."""


def squares(image: Image) -> list[Box]:
    mask = (image[..., 0] == 255).astype(np.uint8)
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask)
    return [Box.from_xywh(*map(float, row[:4])) for row in stats[1:]]


def frame(number: int, places: Places) -> Frame:
    image = NOISE[number].copy()
    for x, y in places:
        left, top = round(x - SIDE / 2), round(y - SIDE / 2)
        image[top : top + SIDE, left : left + SIDE] = 255
    return Frame(image, number / 30, number)


def boxes(places: Places) -> list[Box]:
    return [Box(x, y, SIDE, SIDE) for x, y in places]


@pytest.fixture
def fusion(judge: CandidateModel, tmp_path: Path) -> Make:
    """Make a tracker of several targets whose judge is the hand-made one."""
    path = tmp_path / "judge.json"
    path.write_text(json.dumps({"models": {"others": judge.to_json()}}), "utf-8")
    settings = FusionSettings(model=str(path))

    def make(detector: SquareDetector | None = None) -> MultiFusion:
        return MultiFusion(SquareTracker, detector or SquareDetector(), settings)

    return make


def test_it_follows_one_to_four_targets(fusion: Make) -> None:
    multi = fusion()
    with pytest.raises(RuntimeError, match="not started"):
        multi.step(frame(0, []))
    for count in (0, MOST_TARGETS + 1):
        with pytest.raises(ValueError, match="1 to 4"):
            multi.start(frame(0, []), boxes([(50.0, 50.0)] * count))
    with pytest.raises(ValueError, match="outside the image"):
        multi.start(frame(0, []), [Box(-500, 50, 20, 20)])


def test_four_targets_take_one_pass_of_the_detector_a_frame_at_most(fusion: Make) -> None:
    places = [(100.0, 100.0), (200.0, 200.0), (400.0, 100.0), (500.0, 400.0)]
    detector = SquareDetector()
    multi = fusion(detector)
    tracks = multi.start(frame(0, places), boxes(places))
    assert [track.box for track in tracks] == boxes(places)
    for number in range(1, 25):
        places = [(x + 1, y) for x, y in places]
        tracks = multi.step(frame(number, places))
        assert detector.looks == multi.passes <= number + 1
    assert {track.state for track in tracks} == {TrackState.TRACKING}
    for track, box in zip(tracks, boxes(places), strict=True):
        assert track.box.distance(box) < 3
    assert multi.passes >= 6
    multi.close()


def test_targets_that_lie_together_share_a_pass(fusion: Make) -> None:
    near = [(200.0, 200.0), (260.0, 200.0)]
    multi, alone = fusion(), fusion()
    multi.start(frame(0, near), boxes(near))
    alone.start(frame(0, near), boxes(near)[:1])
    for number in range(1, 20):
        multi.step(frame(number, near))
        alone.step(frame(number, near))
    assert multi.passes <= alone.passes + 1


def test_a_target_that_vanishes_is_not_looked_for_in_another_ones_box(fusion: Make) -> None:
    left, right = (200.0, 240.0), (270.0, 240.0)
    multi = fusion()
    multi.start(frame(0, [left, right]), boxes([left, right]))
    for number in range(1, 45):
        there = [left, right] if number < 20 else [right]
        first, second = multi.step(frame(number, there))
        assert second.state is TrackState.TRACKING
        assert second.box.distance(Box(*right, SIDE, SIDE)) < 3
        if number >= 20:
            assert first.box.iou(second.box) < 0.5
    assert first.state is not TrackState.TRACKING


def test_begun_anew_it_follows_other_targets(fusion: Make) -> None:
    places, others = [(100.0, 100.0)], [(400.0, 300.0), (300.0, 100.0)]
    multi = fusion()
    multi.start(frame(0, places), boxes(places))
    multi.step(frame(1, places))
    multi.start(frame(2, others), boxes(others))
    tracks = multi.step(frame(3, others))
    for track, box in zip(tracks, boxes(others), strict=True):
        assert track.box.distance(box) < 1


def test_who_refuses_a_start_goes_on_with_the_targets_it_has(fusion: Make) -> None:
    multi, places = fusion(), [(100.0, 100.0), (400.0, 300.0)]
    multi.start(frame(0, places), boxes(places))
    with pytest.raises(ValueError, match="outside the image"):
        multi.start(frame(1, places), [*boxes(places), Box(-500, 50, 20, 20)])
    tracks = multi.step(frame(2, places))
    assert [track.state for track in tracks] == [TrackState.TRACKING] * 2


def test_begun_anew_nothing_is_asked_for_the_earlier_targets(fusion: Make) -> None:
    """Far apart, they need a pass each: what waits for the ones before would come first."""
    detector = SquareDetector()
    multi, places = fusion(detector), [(60.0, 60.0), (580.0, 60.0), (60.0, 420.0), (580.0, 420.0)]
    for number in range(5):
        multi.start(frame(number, places), boxes(places))
    begun = detector.looks
    for number in range(5, 8):
        multi.step(frame(number, places))
    assert detector.looks - begun <= 3
    assert multi.passes <= 5 + 3
