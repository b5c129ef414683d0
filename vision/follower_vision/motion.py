"""The seam for motion trackers: a box in, the next frame's box out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from follower_vision.box import Box
from follower_vision.frame import Image


@dataclass(frozen=True, slots=True)
class MotionEstimate:
    """Where a motion tracker believes the target to be.

    Attributes:
        box: in pixels of the image given.
        confidence: 0 to 1; comparable over time for one tracker, not between trackers.
    """

    box: Box
    confidence: float


class MotionTracker(Protocol):
    """Follows one box from image to image; knows no time, states or identities."""

    @property
    def name(self) -> str:
        """A short name for tables and logs, e.g. "correlation"."""
        ...

    def start(self, image: Image, box: Box) -> None:
        """Learn the target anew from its box in `image`; everything earlier is forgotten."""
        ...

    def update(self, image: Image) -> MotionEstimate:
        """Find the target in the next image, (H, W, 3) uint8 BGR.

        Raises:
            RuntimeError: `start` was not called.
        """
        ...


class IdentityTracker:
    """Answers the initial box for ever: the baseline that every tracker has to beat."""

    name = "identity"

    def __init__(self) -> None:
        self._box: Box | None = None

    def start(self, image: Image, box: Box) -> None:  # noqa: ARG002  part of the interface
        """Remember `box`."""
        self._box = box

    def update(self, image: Image) -> MotionEstimate:  # noqa: ARG002  part of the interface
        """Return the box given to `start`."""
        if self._box is None:
            raise RuntimeError("the tracker was not started")
        return MotionEstimate(self._box, 1.0)
