"""The interface of target trackers: frames in, tracks with their states out."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from follower_vision.geometry.box import Box
from follower_vision.geometry.camera_model import CameraView
from follower_vision.images.frame import Frame
from follower_vision.trackers.track import Track


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


class MultiTargetTracker(Protocol):
    """Follows a few targets through time; each track has the states of a `TargetTracker`'s."""

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
        """Release threads."""
        ...


class SeparateTrackers:
    """One tracker a target; they know nothing of each other.

    Args:
        trackers: one for each target, in the targets' order.
        close: releases what the trackers hold, if they hold anything.
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


@dataclass(frozen=True, slots=True)
class MotionForecast:
    """Where the target would be in the next image had it gone on as was believed before.

    What was followed since then may have been something else.

    Attributes:
        since_s: the time stamp of the last frame of which that belief knew.
        cx: where its middle would be, in pixels; beside the image if it left.
        cy: the same downwards.
        likely: where its middle would mostly be.
        nearer: how many times as large it would appear as in that frame.
    """

    since_s: float
    cx: float
    cy: float
    likely: Box
    nearer: float


@dataclass(frozen=True, slots=True)
class TargetPrediction:
    """Where in the next image the target can be, as far as its motion in the world is known.

    Whoever knows how camera and target move in metres knows of places in the image that no target
    reaches in so short a time, however similar what stands there is.

    Attributes:
        cx: where the target's middle should be, in pixels; beside the image if it left.
        cy: the same downwards.
        likely: where its middle mostly is; this, too, may reach beyond the image, or lie outside.
        possible: where it can be at all.
        earlier: the same by what was believed in the last seconds, the latest first.
        range_m: how far off it should be, metres.
        view: how the camera saw the image; None where that is not known.
    """

    cx: float
    cy: float
    likely: Box
    possible: Box
    earlier: tuple[MotionForecast, ...] = ()
    range_m: float = math.nan
    view: CameraView | None = None


@runtime_checkable
class AcceptsPrediction(Protocol):
    """What a target tracker offers that uses predictions."""

    def expect(self, prospect: TargetPrediction | None) -> None:
        """Take what is known of the next frame alone; None is nothing. Call it before `step`."""
        ...
