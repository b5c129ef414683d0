"""Fusion for several targets at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from follower_vision.box import Box
from follower_vision.detection.detection import Detector
from follower_vision.embedding import Embedder
from follower_vision.frame import Frame
from follower_vision.fusion.camera_motion import CameraMotion
from follower_vision.fusion.detection_service import DetectionMode, InlineDetection
from follower_vision.fusion.settings import FusionSettings
from follower_vision.fusion.shared_detection import SharedDetection
from follower_vision.fusion.tracker import FusionTracker
from follower_vision.motion import MotionTracker
from follower_vision.track import Track

MOST_TARGETS = 4
"""As many as Panda and Barczyk's tracker follows."""


class MultiFusion:
    """Follows up to four targets with one detector and one measurement of the camera's motion.

    Each target is a look-alike to the others: a detection that is one's is left to it.
    """

    def __init__(
        self,
        make_motion: Callable[[], MotionTracker],
        detector: Detector,
        settings: FusionSettings | None = None,
        mode: DetectionMode = InlineDetection,
        embedder: Embedder | None = None,
    ) -> None:
        """Make a tracker that waits for `start`.

        Args:
            make_motion: gives each target its motion tracker; they may share a network.
            detector: one pass serves all targets that lie together.
            settings: for all targets.
            mode: `InlineDetection` or `BackgroundDetection`.
            embedder: an appearance network that helps to find a target among its kind.
        """
        self._embedder = embedder
        self._make_motion = make_motion
        self._detector = detector
        self._settings = settings or FusionSettings()
        self._detection = SharedDetection(mode(detector))
        self._camera = CameraMotion()
        self._trackers: list[FusionTracker] = []
        self._tracks: list[Track] = []

    @property
    def passes(self) -> int:
        """How many passes of the detector were begun so far."""
        return self._detection.passes

    def close(self) -> None:
        """Let go of the threads."""
        for tracker in self._trackers:
            tracker.close()
        self._detection.close()

    def start(self, frame: Frame, boxes: Sequence[Box]) -> list[Track]:
        """Choose the targets anew; everything earlier is forgotten.

        Raises:
            ValueError: there are none or too many, or one lies outside the image.
        """
        if not 1 <= len(boxes) <= MOST_TARGETS:
            raise ValueError(f"1 to {MOST_TARGETS} targets can be followed, not {len(boxes)}")
        self._trackers = [self._tracker() for _ in boxes]
        for tracker, box in zip(self._trackers, boxes, strict=True):
            tracker.start(frame, box)
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
        self._camera.update(frame.image, [track.box for track in self._tracks])
        for tracker in self._trackers:
            tracker.advance(frame)
        return self._concluded(frame)

    def _concluded(self, frame: Frame) -> list[Track]:
        self._detection.flush()
        self._tracks = [tracker.conclude(frame) for tracker in self._trackers]
        return self._tracks

    def _tracker(self) -> FusionTracker:
        return FusionTracker(
            self._make_motion(),
            self._detector,
            self._settings,
            mode=lambda _: self._detection,
            camera=self._camera,
            embedder=self._embedder,
        )
