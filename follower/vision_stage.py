"""Frames in, tracks out: what the vision thread runs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

from follower_vision.box import Box
from follower_vision.frame import Frame
from follower_vision.target_tracker import Learner, TargetTracker
from follower_vision.track import Track, TrackState

Selector: TypeAlias = Callable[[Frame], Box | None]
"""Finds the box to follow in a frame, or None if it is not there (yet)."""

OUT_OF_ORDER = "out of order"
"""What a track is said to be produced by that answers for a frame from the past."""


class VisionStage:
    """Selects the target when asked to, then follows it frame by frame.

    `select` may be called from any thread: it replaces one attribute.

    Attributes:
        chosen: the box by which the newest step chose the target, None if it did not.
    """

    def __init__(self, tracker: TargetTracker) -> None:
        self._tracker = tracker
        self._selector: Selector | None = None
        self._started = False
        self._newest_s = -math.inf
        self._track: Track | None = None
        self.chosen: Box | None = None

    def select(self, selector: Selector) -> None:
        """Choose a new target in the coming frames, as soon as `selector` finds one."""
        self._selector = selector

    def step(self, frame: Frame) -> Track | None:
        """Return the target's track in this frame, None while there is no target.

        A frame that is not newer than the last one is not looked at, and answered with where the
        target was then, unseen: trackers measure by the time between frames.
        """
        self.chosen = None
        if not frame.captured_s > self._newest_s:
            return self._out_of_order(frame)
        self._newest_s = frame.captured_s
        self._track = self._followed(frame)
        return self._track

    def learn(self) -> None:
        """Do what the tracker has put off; call it when the track is on its way."""
        if isinstance(self._tracker, Learner):
            self._tracker.learn()

    def _followed(self, frame: Frame) -> Track | None:
        if self._selector is not None:
            self.chosen = self._selector(frame)
        if self.chosen is not None:
            self._selector = None
            self._started = True
            return self._tracker.start(frame, self.chosen)
        return self._tracker.step(frame) if self._started else None

    def _out_of_order(self, frame: Frame) -> Track | None:
        if self._track is None:
            return None
        return replace(
            self._track,
            state=TrackState.COASTING,
            confidence=0.0,
            produced_by=OUT_OF_ORDER,
            captured_s=frame.captured_s,
            sequence=frame.sequence,
        )
