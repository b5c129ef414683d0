"""A motion tracker and a detector that answer as they are told."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from follower_vision.detection.detection import Detection
from follower_vision.detection.detection_service import (
    DetectionAnswer,
    DetectionRequest,
)
from follower_vision.fusion import FusionTracker
from follower_vision.fusion.candidates import corners_of
from follower_vision.geometry.box import Box
from follower_vision.geometry.camera_model import CameraModel, CameraView
from follower_vision.geometry.line_of_sight import along_camera_axes, rotation
from follower_vision.images.frame import Frame, Image
from follower_vision.trackers.motion_tracker import MotionEstimate, ResponseMap
from follower_vision.trackers.target_tracker import TargetPrediction
from follower_vision.trackers.track import Track

RATE_HZ = 30.0
BOX = Box(100, 120, 20, 30)
NOISE = np.random.default_rng(1).integers(40, 215, (80, 240, 320, 3), np.uint8)
LENS = CameraModel.from_fov(320, 240, math.radians(70))
LEVEL = CameraView(LENS, along_camera_axes(rotation(0, 0, 0)), np.zeros(3), math.radians(2))
Sight = tuple[Box, float]
Trackers = Callable[..., FusionTracker]


class ToldMotion:
    """Finds what the test says, wherever it searches: boxes with their likeness."""

    name = "told"

    def __init__(self) -> None:
        self.sights: list[Sight] = [(BOX, 1.0)]
        self.searched: list[Box] = []
        self.learnt: list[Box] = []

    def start(self, image: Image, box: Box) -> None:
        """There is nothing to learn."""

    def update(self, image: Image) -> MotionEstimate:  # noqa: ARG002  part of the interface
        return MotionEstimate(*self.sights[0])

    def search(self, image: Image, box: Box) -> ResponseMap:  # noqa: ARG002
        self.searched.append(box)
        scores = np.array([score for _, score in self.sights])
        corners = corners_of([one for one, _ in self.sights])
        return ResponseMap(corners, scores, np.ones(len(scores)), box.scaled(4.0))

    def learn(self, image: Image, box: Box, probability: float) -> None:  # noqa: ARG002
        self.learnt.append(box)


class ToldDetector:
    """Sees what the test says."""

    class_names = ("thing",)

    def __init__(self) -> None:
        self.sees: list[Detection] = []
        self.regions: list[Box | None] = []

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:  # noqa: ARG002
        self.regions.append(region)
        return self.sees


class HeldDetection:
    """Holds each request until the test says what its answer is."""

    def __init__(self) -> None:
        self.requests: list[DetectionRequest] = []
        self.answers: list[DetectionAnswer] = []

    def ready(self, *, urgent: bool = False) -> bool:  # noqa: ARG002
        return True

    def submit(self, request: DetectionRequest) -> None:
        self.requests.append(request)

    def take(self, owner: object) -> list[DetectionAnswer]:
        mine = [one for one in self.answers if one.request.owner is owner]
        self.answers = []
        return mine

    def forget(self, owner: object) -> None:
        """The test itself holds the requests."""

    def close(self) -> None:
        """There is nothing to release."""


def frame(number: int, time_s: float | None = None) -> Frame:
    return Frame(NOISE[number], number / RATE_HZ if time_s is None else time_s, number)


def seen(box: Box, score: float = 0.9) -> Detection:
    return Detection(box, 0, "thing", score)


def follow(
    tracker: FusionTracker, motion: ToldMotion, sights: Iterable[Sequence[Sight]], first: int = 1
) -> list[Track]:
    """Step through frames in which the motion tracker finds these."""
    tracks = []
    for number, told in enumerate(sights, first):
        motion.sights = list(told)
        tracks.append(tracker.step(frame(number)))
    return tracks


def foreseen(place: Box, side_px: float = 60.0) -> TargetPrediction:
    likely = Box(place.cx, place.cy, side_px, side_px)
    return TargetPrediction(place.cx, place.cy, likely, likely.scaled(2.0))


def going_right(frames: int, px: float = 3.0) -> list[list[Sight]]:
    return [[(BOX.moved_to(BOX.cx + px * k, BOX.cy), 1.0)] for k in range(1, frames + 1)]


def unseen(frames: int) -> list[list[Sight]]:
    return [[(BOX, 0.0)]] * frames
