"""What is compared: trackers by their names on the command line."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass

from follower_control.strict_yaml import SettingsError
from follower_vision.box import Box
from follower_vision.detection import make_detector
from follower_vision.frame import Frame
from follower_vision.fusion import FusionSettings, FusionTracker
from follower_vision.longterm import LongTermTracker
from follower_vision.models import ModelStore, default_folder
from follower_vision.motion import MotionTracker
from follower_vision.target_tracker import TargetTracker
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

    def make(self) -> TargetTracker | MotionTracker:
        """Return a fresh tracker.

        Raises:
            ModelError: a network is missing.
        """
        kind, _, name = self.name.rpartition(":")
        store = ModelStore(default_folder(os.environ))
        motion = make_tracker(name, store.file)
        if not kind:
            return motion
        if kind == "longterm":
            return LongTermTracker(motion)
        settings = FusionSettings.paper() if kind == "fusion-paper" else FusionSettings()
        return FusionTracker(motion, make_detector(self.detector, store), settings)


def stepper(
    tracker: TargetTracker | MotionTracker, first: Frame, box: Box
) -> Callable[[Frame], Box]:
    """Start a tracker of either kind; return what gives its box in the next frame."""
    if hasattr(tracker, "step"):
        tracker.start(first, box)
        return lambda frame: tracker.step(frame).box
    tracker.start(first.image, box)
    return lambda frame: tracker.update(frame.image).box
