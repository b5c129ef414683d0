"""The interface of motion trackers: a box in, the next frame's box out."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image

Floats = npt.NDArray[np.floating]

_ABOUT = 4.0
_SAME_IOU = 0.5
_SURE = 0.7


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
    """Follows one box from image to image; knows no time, states or identities.

    Others look at the same images: they are not to be written into.
    """

    @property
    def name(self) -> str:
        """A short name for tables and logs, e.g. "correlation"."""
        ...

    def start(self, image: Image, box: Box) -> None:
        """Learn the target anew from its box in pixels of `image`, (H, W, 3) uint8 BGR."""
        ...

    def update(self, image: Image) -> MotionEstimate:
        """Find the target in the next image, (H, W, 3) uint8 BGR.

        Raises:
            RuntimeError: `start` was not called.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ResponseMap:
    """How a motion tracker answers to each of N places in a searched region.

    Attributes:
        corners: (N, 4) left, top, right, bottom of the box at each place, in the image's pixels.
        scores: (N,) likeness to the target, 0 to 1.
        penalty: (N,) factor, at most 1, for a size or shape unlike the one searched for.
        region: the searched region, in the image's pixels.
        image_features: (H, W, C) the network's features of the region; None without a network.
        second: where another motion tracker believes the target to be; None without one.
    """

    corners: Floats
    scores: Floats
    penalty: Floats
    region: Box
    image_features: Floats | None = None
    second: MotionEstimate | None = None

    def finite(self, otherwise: Box) -> ResponseMap:
        """Leave out what is not finite; if no place is left, `otherwise` has likeness 0."""
        features = self.image_features
        if features is not None and not np.isfinite(features).all():
            return replace(self, image_features=np.zeros_like(features)).finite(otherwise)
        second = self.second
        if second is not None and not math.isfinite(second.confidence):
            return replace(self, second=None).finite(otherwise)
        numbers = np.column_stack([self.corners, self.scores, self.penalty])
        kept = np.isfinite(numbers).all(axis=1)
        if kept.all():
            return self
        if kept.any():
            numbers = numbers[kept]
        else:
            edges = [otherwise.left, otherwise.top, otherwise.right, otherwise.bottom]
            numbers = np.array([[*edges, 0.0, 1.0]])
        parts = numbers[:, :4], numbers[:, 4], numbers[:, 5]
        return ResponseMap(*parts, self.region, self.image_features, self.second)


@runtime_checkable
class ResponseTracker(Protocol):
    """What a motion tracker offers that says more of a search than its best place."""

    def search(self, image: Image, box: Box) -> ResponseMap:
        """Search `image`, (H, W, 3) uint8 BGR, about `box`; the tracker itself goes nowhere.

        Raises:
            RuntimeError: `start` was not called.
        """
        ...

    def learn(self, image: Image, box: Box, probability: float) -> None:
        """Learn from the image searched last, in which the target is at `box`, so probably."""
        ...


class SearchingTracker(MotionTracker, ResponseTracker, Protocol):
    """A motion tracker that is a `ResponseTracker` too."""


class OnePlaceResponse:
    """Makes a `ResponseTracker` of a motion tracker that names its best place alone.

    It goes its own way; where the target is learnt to be elsewhere, it starts anew there.

    Attributes:
        found: what it said of the image searched last; None before that.
    """

    def __init__(self, motion: MotionTracker) -> None:
        self._motion = motion
        self.found: MotionEstimate | None = None

    def search(self, image: Image, box: Box) -> ResponseMap:
        """See `ResponseTracker`; the place does not depend on where it is searched."""
        self.found = estimate = self._motion.update(image)
        found = estimate.box
        corners = np.array([[found.left, found.top, found.right, found.bottom]])
        score = np.array([estimate.confidence])
        return ResponseMap(corners, score, np.ones(1), box.scaled(_ABOUT))

    def learn(self, image: Image, box: Box, probability: float) -> None:
        """See `ResponseTracker`."""
        strayed = self.found is not None and self.found.box.iou(box) < _SAME_IOU
        if strayed and probability >= _SURE:
            self._motion.start(image, box)


class JoinedTracker:
    """Two motion trackers at once: the first one searches, the second names its best place too.

    Args:
        first: answers to each place it searches.
        second: see `OnePlaceResponse`.

    Attributes:
        name: a short name for tables and logs.
    """

    def __init__(self, first: SearchingTracker, second: MotionTracker) -> None:
        self.name = f"{first.name}-{second.name}"
        self._first, self._second = first, second
        self._response = OnePlaceResponse(second)

    def start(self, image: Image, box: Box) -> None:
        """See `MotionTracker`."""
        self._first.start(image, box)
        self._second.start(image, box)

    def update(self, image: Image) -> MotionEstimate:
        """See `MotionTracker`; without Fusion the first one counts."""
        return self._first.update(image)

    def search(self, image: Image, box: Box) -> ResponseMap:
        """See `ResponseTracker`."""
        self._response.search(image, box)
        return replace(self._first.search(image, box), second=self._response.found)

    def learn(self, image: Image, box: Box, probability: float) -> None:
        """See `ResponseTracker`."""
        self._first.learn(image, box, probability)
        self._response.learn(image, box, probability)


class IdentityTracker:
    """Always returns the initial box: the baseline that every tracker has to beat."""

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
