"""Frames in, tracks out: what the vision thread runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from follower_vision.box import Box
from follower_vision.frame import Frame
from follower_vision.target_tracker import Learner, TargetTracker
from follower_vision.track import Track

Selector: TypeAlias = Callable[[Frame], Box | None]
"""Finds the box to follow in a frame, or None if it is not there (yet)."""


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
        self.chosen: Box | None = None

    def select(self, selector: Selector) -> None:
        """Choose a new target in the coming frames, as soon as `selector` finds one."""
        self._selector = selector

    def step(self, frame: Frame) -> Track | None:
        """Return the target's track in this frame, None while there is no target."""
        selector = self._selector
        self.chosen = None if selector is None else selector(frame)
        if self.chosen is not None:
            self._selector = None
            self._started = True
            return self._tracker.start(frame, self.chosen)
        return self._tracker.step(frame) if self._started else None

    def learn(self) -> None:
        """Do what the tracker has put off; call it when the track is on its way."""
        if isinstance(self._tracker, Learner):
            self._tracker.learn()
