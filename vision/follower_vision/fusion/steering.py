"""What some motion trackers can do besides following: the seams that Fusion makes use of."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from follower_vision.box import Box
from follower_vision.frame import Image
from follower_vision.motion import MotionEstimate, MotionTracker


@runtime_checkable
class SteerableTracker(MotionTracker, Protocol):
    """A motion tracker that can be sent elsewhere without forgetting what it looks for.

    How often it looks at an image before the next one does not matter: an answer that nobody uses
    does no harm.
    """

    def move_to(self, box: Box) -> None:
        """Search about `box` next time."""
        ...


@runtime_checkable
class CorrectableTracker(SteerableTracker, Protocol):
    """A motion tracker that remembers more than a place, and can be told what is right."""

    def correct(self, image: Image, box: Box) -> None:
        """Go on from where the target is in `image`, without learning it anew."""
        ...


@runtime_checkable
class ProbingTracker(MotionTracker, Protocol):
    """A motion tracker that can look somewhere without going there."""

    def probe(self, image: Image, box: Box) -> list[MotionEstimate]:
        """Return the places like the target about `box`, the likest first."""
        ...


@runtime_checkable
class CandidateTracker(SteerableTracker, Protocol):
    """A motion tracker that tells every place like the target that it saw in its last update."""

    def candidates(self, least: float = 0.0) -> list[MotionEstimate]:
        """Return the places like the target, the likest first; `least` is their confidence."""
        ...
