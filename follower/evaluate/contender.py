"""What is compared: trackers by their names on the command line."""

from __future__ import annotations

import os
from dataclasses import dataclass

from follower_control.strict_yaml import SettingsError
from follower_vision.box import Box
from follower_vision.detection import make_detector
from follower_vision.frame import Frame
from follower_vision.fusion import FusionSettings, FusionTracker
from follower_vision.longterm import LongTermTracker
from follower_vision.models import ModelStore, default_folder
from follower_vision.motion import MotionEstimate, MotionTracker
from follower_vision.target_tracker import TargetTracker
from follower_vision.track import Track, TrackState
from follower_vision.trackers import make_tracker, tracker_names

_KINDS = ("longterm", "fusion", "fusion-paper")


@dataclass(frozen=True, slots=True)
class Contender:
    """A tracker to be measured.

    Attributes:
        name: as on the command line.
        detector: that of the kinds with one.
    """

    name: str
    detector: str

    def __post_init__(self) -> None:
        kind, _, motion = self.name.rpartition(":")
        if (kind and kind not in _KINDS) or motion not in tracker_names():
            raise SettingsError(
                f"--trackers {self.name}: write a name from `follower trackers`, or one of "
                f"{', '.join(f'{kind}:NAME' for kind in _KINDS)}"
            )

    @property
    def identity(self) -> str:
        """What a stored result must agree with."""
        return f"{self.name} {self.detector}" if "fusion" in self.name else self.name

    def make(self) -> TargetTracker:
        """Return a fresh tracker.

        Raises:
            ModelError: a network is missing.
        """
        kind, _, name = self.name.rpartition(":")
        store = ModelStore(default_folder(os.environ))
        motion = make_tracker(name, store.file)
        if not kind:
            return AlwaysBelieved(motion)
        if kind == "longterm":
            return LongTermTracker(motion)
        settings = FusionSettings.paper() if kind == "fusion-paper" else FusionSettings()
        return FusionTracker(motion, make_detector(self.detector, store), settings)


class AlwaysBelieved:
    """A motion tracker as a target tracker that never says that it lost its target."""

    def __init__(self, motion: MotionTracker) -> None:
        self._motion = motion

    def start(self, frame: Frame, box: Box) -> Track:
        """See `TargetTracker`."""
        self._motion.start(frame.image, box)
        return self._track(frame, MotionEstimate(box, 1.0))

    def step(self, frame: Frame) -> Track:
        """See `TargetTracker`."""
        return self._track(frame, self._motion.update(frame.image))

    def _track(self, frame: Frame, estimate: MotionEstimate) -> Track:
        return Track(
            estimate.box,
            TrackState.TRACKING,
            estimate.confidence,
            self._motion.name,
            frame.captured_s,
            frame.sequence,
        )
