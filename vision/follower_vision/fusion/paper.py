"""Fusion as published, its slips corrected: the baseline that everything else is compared with.

Panda and Barczyk, "Blending of Learning-based Tracking and Object Detection for Monocular
Camera-based Target Following" (IFAC 2019). Departures, each one a slip of the listing: blurred
means a *low* variance of the Laplacian, divided by the number of pixels, in the new frame; "at
least one detection" means more than zero; of several detections the one that overlaps the motion
tracker's box validates it; and one missed detection does not yet mean lost.
"""

from __future__ import annotations

from collections import Counter

from follower_vision.appearance.blur import BlurDetector
from follower_vision.appearance.reidentify import LEARNING_S, Reidentifier
from follower_vision.detection.detection import Detection, Detector
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.trackers.motion_tracker import MotionTracker
from follower_vision.trackers.track import Track, TrackState

_VALIDATE_EVERY = 10
_MATCH_IOU = 0.3
_MISSES_TO_LOSE = 5


class PaperFusion:
    """Follows one target as the paper does; see `TargetTracker`.

    A target of a class that the detector does not know is followed by the motion tracker alone.

    Args:
        motion: follows the box between validations.
        detector: validates, re-initialises and finds again.
    """

    def __init__(self, motion: MotionTracker, detector: Detector) -> None:
        self._motion = motion
        self._detector = detector
        self._known = Reidentifier()
        self._track: Track | None = None

    def start(self, frame: Frame, box: Box) -> Track:
        """Choose the target: what `box` shows in `frame`. Everything earlier is forgotten."""
        self._blur = BlurDetector()
        self._votes: Counter[int] = Counter()
        self._since_look = self._misses = 0
        self._started_s = frame.captured_s
        self._motion.start(frame.image, box)
        self._known.start(frame.image, box, frame.captured_s)
        self._vote(self._detector.detect(frame.image), box)
        return self._answer(frame, box, TrackState.TRACKING, 1.0, self._motion.name)

    def step(self, frame: Frame) -> Track:
        """Return the target's track in the next frame.

        Raises:
            RuntimeError: `start` was not called.
        """
        last = self._track
        if last is None:
            raise RuntimeError("the tracker was not started")
        if last.state is TrackState.LOST:
            return self._search(frame, last)
        estimate = self._motion.update(frame.image)
        blurred = self._blur.update(frame.image, estimate.box, frame.captured_s)
        self._since_look += 1
        if self._since_look >= _VALIDATE_EVERY or blurred:
            return self._validate(frame, estimate.box, estimate.confidence)
        if self._misses == 0:
            self._known.learn(frame.image, estimate.box, frame.captured_s)
        name = self._motion.name
        return self._answer(frame, estimate.box, TrackState.TRACKING, estimate.confidence, name)

    def _validate(self, frame: Frame, box: Box, confidence: float) -> Track:
        self._since_look = 0
        detections = self._detector.detect(frame.image)
        if frame.captured_s - self._started_s <= LEARNING_S:
            self._vote(detections, box)
        overlaps = [(one.box.iou(box), one.box) for one in self._of_its_class(detections)]
        overlap, nearest = max(overlaps, key=lambda pair: pair[0], default=(0.0, box))
        if overlap >= _MATCH_IOU:
            self._misses = 0
            self._motion.start(frame.image, nearest)
            return self._answer(frame, nearest, TrackState.TRACKING, 1.0, "detector")
        self._misses += bool(self._votes)
        lost = self._misses >= _MISSES_TO_LOSE
        state = TrackState.LOST if lost else TrackState.TRACKING
        return self._answer(frame, box, state, 0.0 if lost else confidence, self._motion.name)

    def _search(self, frame: Frame, last: Track) -> Track:
        """Look through the whole frame for what is of its class and looks like the target."""
        boxes = [one.box for one in self._of_its_class(self._detector.detect(frame.image))]
        found = self._known.best(frame.image, boxes)
        if found is None:
            return self._answer(frame, last.box, TrackState.LOST, 0.0, "lost")
        self._misses = self._since_look = 0
        self._motion.start(frame.image, found[0])
        return self._answer(frame, found[0], TrackState.TRACKING, 1.0, "reacquired")

    def _vote(self, detections: list[Detection], box: Box) -> None:
        overlaps = [(one.box.iou(box), one.class_id) for one in detections]
        overlap, kind = max(overlaps, default=(0.0, 0))
        if overlap >= _MATCH_IOU:
            self._votes[kind] += 1

    def _of_its_class(self, detections: list[Detection]) -> list[Detection]:
        most = self._votes.most_common(1)
        return [one for one in detections if most and one.class_id == most[0][0]]

    def _answer(
        self, frame: Frame, box: Box, state: TrackState, confidence: float, produced_by: str
    ) -> Track:
        self._track = Track(box, state, confidence, produced_by, frame.captured_s, frame.sequence)
        return self._track
