"""The seam for target trackers: frames in, tracks with honest states out."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from follower_vision.box import Box
from follower_vision.frame import Frame
from follower_vision.track import Track


class TargetTracker(Protocol):
    """Follows one target through time, and says when it does not see it."""

    def start(self, frame: Frame, box: Box) -> Track:
        """Choose the target anew: what `box` shows in `frame`. Everything earlier is forgotten."""
        ...

    def step(self, frame: Frame) -> Track:
        """Return the target's track in the next frame; frames may have been dropped between.

        Raises:
            RuntimeError: `start` was not called.
        """
        ...


@runtime_checkable
class Learner(Protocol):
    """What a target tracker offers that puts off to after its answer what can wait."""

    def learn(self) -> None:
        """Learn from the last frame; the next `step` does it if nobody did, with the same result.

        It is for those who want an answer early: call it once the answer is out.
        """
        ...
