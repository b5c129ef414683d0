"""Several targets, one detector."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from follower_vision.detection.detection import Detector
from follower_vision.detection.detection_service import (
    DetectionMode,
    InlineDetection,
    SharedDetection,
)
from follower_vision.fusion.settings import FusionSettings
from follower_vision.fusion.tracker import FusionTracker
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.trackers.motion_tracker import MotionTracker
from follower_vision.trackers.track import Track

MOST_TARGETS = 4
"""As many as Panda and Barczyk's tracker follows."""


class MultiFusion:
    """Follows up to four targets with one detector.

    A candidate that is one's target is left to it by the others.

    Args:
        make_motion: gives each target its motion tracker; they may share a network.
        detector: one pass serves all targets that lie together.
        settings: for all targets.
        mode: `InlineDetection` or `BackgroundDetection`.
    """

    def __init__(
        self,
        make_motion: Callable[[], MotionTracker],
        detector: Detector,
        settings: FusionSettings | None = None,
        mode: DetectionMode = InlineDetection,
    ) -> None:
        self._make_motion = make_motion
        self._detector = detector
        self._settings = settings or FusionSettings()
        self._detection = SharedDetection(mode(detector))
        self._trackers: list[FusionTracker] = []

    @property
    def passes(self) -> int:
        """How many passes of the detector were begun so far."""
        return self._detection.passes

    def close(self) -> None:
        """Release the threads."""
        self._detection.close()

    def start(self, frame: Frame, boxes: Sequence[Box]) -> list[Track]:
        """Choose the targets anew; everything earlier is forgotten.

        Raises:
            ValueError: there are none or too many, or one lies outside the image. The earlier
                targets are still followed then.
        """
        if not 1 <= len(boxes) <= MOST_TARGETS:
            raise ValueError(f"1 to {MOST_TARGETS} targets can be followed, not {len(boxes)}")
        trackers = [self._tracker() for _ in boxes]
        try:
            for tracker, box in zip(trackers, boxes, strict=True):
                tracker.start(frame, box)
        except ValueError:
            for tracker in trackers:
                tracker.forget_requests()
            raise
        for tracker in self._trackers:
            tracker.forget_requests()
        self._trackers = trackers
        for tracker in self._trackers:
            tracker.beside([other for other in self._trackers if other is not tracker])
        return self._concluded(frame)

    def step(self, frame: Frame) -> list[Track]:
        """Return all targets' tracks in the next frame, in the order of `start`.

        Raises:
            RuntimeError: `start` was not called.
        """
        if not self._trackers:
            raise RuntimeError("the tracker was not started")
        for tracker in self._trackers:
            tracker.advance(frame)
        return self._concluded(frame)

    def _concluded(self, frame: Frame) -> list[Track]:
        self._detection.flush()
        return [tracker.conclude(frame) for tracker in self._trackers]

    def _tracker(self) -> FusionTracker:
        return FusionTracker(
            self._make_motion(), self._detector, self._settings, lambda _: self._detection
        )
