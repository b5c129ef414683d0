"""The seam for trackers of several targets, and the plainest of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from follower_vision.box import Box
from follower_vision.frame import Frame
from follower_vision.target_tracker import TargetTracker
from follower_vision.track import Track


class MultiTargetTracker(Protocol):
    """Follows a few targets through time; each track is as honest as a `TargetTracker`'s."""

    def start(self, frame: Frame, boxes: Sequence[Box]) -> list[Track]:
        """Choose the targets anew: what `boxes` show in `frame`.

        Raises:
            ValueError: so many targets cannot be followed, or one lies outside the image.
        """
        ...

    def step(self, frame: Frame) -> list[Track]:
        """Return all tracks in the next frame, in the order of `start`.

        Raises:
            RuntimeError: `start` was not called.
        """
        ...

    def close(self) -> None:
        """Let go of threads."""
        ...


class SeparateTrackers:
    """One tracker a target; they know nothing of each other.

    Args:
        trackers: one for each target, in the targets' order.
        close: lets go of what the trackers hold, if they hold anything.
    """

    def __init__(
        self, trackers: Sequence[TargetTracker], close: Callable[[], None] | None = None
    ) -> None:
        self._trackers = tuple(trackers)
        self._close = close

    def start(self, frame: Frame, boxes: Sequence[Box]) -> list[Track]:
        """See `MultiTargetTracker`."""
        if len(boxes) != len(self._trackers):
            raise ValueError(f"{len(self._trackers)} targets were announced, not {len(boxes)}")
        pairs = zip(self._trackers, boxes, strict=True)
        return [tracker.start(frame, box) for tracker, box in pairs]

    def step(self, frame: Frame) -> list[Track]:
        """See `MultiTargetTracker`."""
        return [tracker.step(frame) for tracker in self._trackers]

    def close(self) -> None:
        """See `MultiTargetTracker`."""
        if self._close is not None:
            self._close()
