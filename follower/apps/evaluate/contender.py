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
from follower_vision.trackers import is_tracker, make_tracker

_KINDS = ("longterm", "fusion", "fusion-paper")
_WITH_DETECTOR = frozenset({"fusion", "fusion-paper"})
_MOTION = "nanotrack-v3"


@dataclass(frozen=True, slots=True)
class Contender:
    """A tracker to be measured.

    Attributes:
        name: as on the command line: a motion tracker, or KIND:MOTION+DETECTOR, of which the
            motion tracker (nanotrack-v3) and the detector may be left out.
        default_detector: for the kinds with one.
    """

    name: str
    default_detector: str

    def __post_init__(self) -> None:
        if not is_tracker(self.motion) or (self.asked_detector and not self.detector):
            raise SettingsError(
                f"--trackers {self.name}: write a name from `follower trackers`, a network's "
                f"path, or one of {', '.join(_KINDS)}, alone or as KIND:NAME or KIND:NAME+DETECTOR"
            )

    @property
    def kind(self) -> str:
        """Either "longterm", "fusion", "fusion-paper", or "" for a motion tracker alone."""
        head = self.name.partition(":")[0].partition("+")[0]
        return head if head in _KINDS else ""

    @property
    def motion(self) -> str:
        """The motion tracker's name."""
        rest = self.name.removeprefix(self.kind).partition("+")[0].removeprefix(":")
        return rest if rest or not self.kind else _MOTION

    @property
    def asked_detector(self) -> str:
        """The detector that the name asks for, "" if none."""
        return self.name.partition("+")[2]

    @property
    def detector(self) -> str:
        """The detector's name, "" for the kinds without one."""
        return (self.asked_detector or self.default_detector) if self.kind in _WITH_DETECTOR else ""

    @property
    def has_states(self) -> bool:
        """Whether the tracker ever says that it does not see its target."""
        return bool(self.kind)

    @property
    def identity(self) -> str:
        """What a stored result must agree with."""
        return f"{self.kind or 'motion'} {self.motion} {self.detector}".strip()

    def make(self) -> TargetTracker:
        """Return a fresh tracker.

        Raises:
            ModelError: a network is missing.
        """
        store = ModelStore(default_folder(os.environ))
        motion = make_tracker(self.motion, store.file)
        if not self.kind:
            return AlwaysBelieved(motion)
        if self.kind == "longterm":
            return LongTermTracker(motion)
        settings = FusionSettings.paper() if self.kind == "fusion-paper" else FusionSettings()
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
