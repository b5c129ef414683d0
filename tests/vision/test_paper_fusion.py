"""The paper's rules: every tenth frame and on blur the detector, re-identification after a loss."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from follower_vision.detection.detection import Detection
from follower_vision.fusion import PaperFusion
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.trackers.motion_tracker import MotionEstimate
from follower_vision.trackers.track import Track, TrackState

BOX = Box(100, 120, 40, 40)
RNG = np.random.default_rng(5)
GROUND = RNG.integers(90, 130, (240, 320, 3), np.uint8)
TARGET, STRANGER = RNG.integers(0, 255, (2, 40, 40, 3), np.uint8)


class ToldMotion:
    """Says where the target is as the test says."""

    name = "told"

    def __init__(self) -> None:
        self.box = BOX
        self.started: list[Box] = []

    def start(self, image: Image, box: Box) -> None:  # noqa: ARG002  part of the interface
        self.started.append(box)
        self.box = box

    def update(self, image: Image) -> MotionEstimate:  # noqa: ARG002
        return MotionEstimate(self.box, 0.8)


class ToldDetector:
    """Sees what the test says, and counts how often it is asked."""

    class_names = ("thing", "other")

    def __init__(self) -> None:
        self.sees = [Detection(BOX, 0, "thing", 0.9)]
        self.looks = 0

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:  # noqa: ARG002
        assert region is None, "the paper looks at the whole image"
        self.looks += 1
        return self.sees


class Pursuit:
    """The paper's tracker, its told parts, and the frames."""

    def __init__(self, picture: Image = TARGET) -> None:
        self.motion, self.detector = ToldMotion(), ToldDetector()
        self.tracker = PaperFusion(self.motion, self.detector)
        self._number = 0
        self.first = self.tracker.start(self.frame(picture), BOX)

    def frame(self, picture: Image, box: Box = BOX) -> Frame:
        image = GROUND.copy()
        top, left = round(box.top), round(box.left)
        image[top : top + 40, left : left + 40] = picture
        frame = Frame(image, self._number / 30, self._number)
        self._number += 1
        return frame

    def go(self, frames: int, picture: Image = TARGET, box: Box = BOX) -> list[Track]:
        return [self.tracker.step(self.frame(picture, box)) for _ in range(frames)]


def test_it_has_to_be_started() -> None:
    with pytest.raises(RuntimeError, match="not started"):
        PaperFusion(ToldMotion(), ToldDetector()).step(Frame(GROUND, 0.0, 0))


def test_the_detector_is_asked_every_tenth_frame() -> None:
    pursuit = Pursuit()
    assert (pursuit.first.state, pursuit.first.produced_by) == (TrackState.TRACKING, "told")
    tracks = pursuit.go(30)
    assert pursuit.detector.looks == 1 + 3
    assert [track.sequence for track in tracks if track.produced_by == "detector"] == [10, 20, 30]
    assert {track.state for track in tracks} == {TrackState.TRACKING}


def test_a_detection_that_overlaps_starts_the_motion_tracker_anew() -> None:
    pursuit, seen = Pursuit(), Box(108, 120, 44, 40)
    far = Detection(Box(220, 60, 40, 40), 0, "thing", 0.95)
    pursuit.detector.sees = [far, Detection(seen, 0, "thing", 0.5)]
    track = pursuit.go(10)[-1]
    assert (track.box, track.confidence) == (seen, 1.0)
    assert pursuit.motion.started == [BOX, seen]


def test_a_blurred_frame_is_validated_at_once() -> None:
    pursuit = Pursuit()
    pursuit.go(8)
    looks = pursuit.detector.looks
    blurred = np.asarray(cv2.GaussianBlur(TARGET, (15, 15), 5), np.uint8)
    pursuit.go(1, blurred)
    assert pursuit.detector.looks == looks + 1
    pursuit.go(9)
    assert pursuit.detector.looks == looks + 1, "the count begins anew"


def test_five_validations_in_vain_lose_the_target() -> None:
    pursuit = Pursuit()
    pursuit.go(10)
    pursuit.detector.sees = []
    states = [track.state for track in pursuit.go(50)]
    assert states == [TrackState.TRACKING] * 49 + [TrackState.LOST]


def test_one_hit_between_them_forgives_the_misses() -> None:
    pursuit = Pursuit()
    for _ in range(3):
        pursuit.detector.sees = []
        pursuit.go(40)
        pursuit.detector.sees = [Detection(BOX, 0, "thing", 0.9)]
        assert pursuit.go(10)[-1].state is TrackState.TRACKING


def lost() -> Pursuit:
    pursuit = Pursuit()
    pursuit.go(10)
    pursuit.detector.sees = []
    pursuit.go(50)
    return pursuit


def test_a_lost_target_is_found_by_its_looks_anywhere() -> None:
    pursuit, place = lost(), Box(240, 60, 40, 40)
    track = pursuit.go(1)[0]
    assert (track.state, track.confidence, track.box) == (TrackState.LOST, 0.0, BOX)
    pursuit.detector.sees = [Detection(place, 0, "thing", 0.9)]
    track = pursuit.go(1, box=place)[0]
    assert (track.state, track.produced_by, track.box) == (TrackState.TRACKING, "reacquired", place)
    assert pursuit.motion.started[-1] == place


def test_whoever_looks_different_is_not_the_target() -> None:
    pursuit = lost()
    pursuit.detector.sees = [Detection(BOX, 0, "thing", 0.9)]
    assert pursuit.go(1, STRANGER)[0].state is TrackState.LOST


def test_another_class_is_neither_a_validation_nor_a_find() -> None:
    pursuit = Pursuit()
    pursuit.go(30)
    pursuit.detector.sees = [Detection(BOX, 1, "other", 0.9)]
    assert pursuit.go(50)[-1].state is TrackState.LOST
    assert pursuit.go(1)[0].state is TrackState.LOST


def test_what_the_detector_does_not_know_is_left_to_the_motion_tracker() -> None:
    pursuit = Pursuit()
    unknown = PaperFusion(pursuit.motion, pursuit.detector)
    pursuit.detector.sees = []
    unknown.start(Frame(GROUND, 0.0, 0), BOX)
    tracks = [unknown.step(Frame(GROUND, k / 30, k)) for k in range(1, 80)]
    assert {(track.state, track.produced_by) for track in tracks} == {(TrackState.TRACKING, "told")}


def test_begun_anew_it_knows_nothing_of_before() -> None:
    pursuit = lost()
    track = pursuit.tracker.start(pursuit.frame(STRANGER), BOX)
    assert track.state is TrackState.TRACKING
    pursuit.detector.sees = [Detection(BOX, 1, "other", 0.9)]
    assert pursuit.go(10, STRANGER)[-1].produced_by == "detector"
