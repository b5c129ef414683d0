"""Motion trackers of other packages, whose faults end no flight."""

import math
from dataclasses import replace
from functools import partial

import numpy as np

from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.plugins import SURE, Plugin, PluginGroup, PluginGuard
from follower_vision.trackers.motion_tracker import (
    MotionEstimate,
    MotionTracker,
    ResponseMap,
    ResponseTracker,
)

TRACKER_PLUGINS = PluginGroup("follower.trackers", "tracker", ("start", "update"))
"""Each makes a `MotionTracker` when it is called like an entry of `registry.TRACKERS`."""

_ABOUT = 4.0


def guarded(motion: MotionTracker, plugin: Plugin) -> MotionTracker:
    """Return a plug-in's tracker behind a guard, with its map of responses if it has one."""
    if isinstance(motion, ResponseTracker):
        return GuardedResponseTracker(motion, motion, plugin)
    return GuardedTracker(motion, plugin)


class GuardedTracker:
    """Asks a plug-in's tracker; where that raises or errs, the target is not seen.

    The answer is then the last box with the confidence 0, on which target trackers coast.

    Attributes:
        name: the plug-in's.
    """

    def __init__(self, motion: MotionTracker, plugin: Plugin) -> None:
        self._motion = motion
        self._guard = PluginGuard(plugin)
        self._box: Box | None = None
        self.name = plugin.entry.name

    def start(self, image: Image, box: Box) -> None:
        """See `MotionTracker`."""
        self._box = box
        self._guard.run(partial(self._motion.start, image, box), None, lambda _: True)

    def update(self, image: Image) -> MotionEstimate:
        """See `MotionTracker`."""
        unseen = MotionEstimate(self._started(), 0.0)
        estimate = self._guard.run(partial(self._motion.update, image), unseen, _is_estimate)
        self._box = estimate.box
        return estimate

    def _started(self) -> Box:
        if self._box is None:
            raise RuntimeError("the tracker was not started")
        return self._box


class GuardedResponseTracker(GuardedTracker):
    """The same for a tracker that offers its map of responses.

    The first map after a start says how many channels of features there are; others have as many.

    Args:
        motion: the plug-in's.
        response: the same.
        plugin: where it is from.
    """

    def __init__(self, motion: MotionTracker, response: ResponseTracker, plugin: Plugin) -> None:
        super().__init__(motion, plugin)
        self._response = response
        self._channels: int | None = None

    def start(self, image: Image, box: Box) -> None:
        """See `MotionTracker`."""
        super().start(image, box)
        self._channels = None

    def search(self, image: Image, box: Box) -> ResponseMap:
        """See `ResponseTracker`."""
        self._started()
        corners = np.array([[box.left, box.top, box.right, box.bottom]])
        unseen = ResponseMap(corners, np.zeros(1), np.ones(1), box.scaled(_ABOUT))

        def is_sound(answer: ResponseMap) -> bool:
            fits = _is_response(answer)
            return fits and (not self._channels or _channels(answer) in (0, self._channels))

        answer = self._guard.run(partial(self._response.search, image, box), unseen, is_sound)
        if self._channels is None:
            self._channels = _channels(answer)
        if _channels(answer) == self._channels:
            return answer
        # What features are compared with has as many channels.
        blank = np.zeros((2, 2, self._channels)) if self._channels else None
        return replace(answer, image_features=blank)

    def learn(self, image: Image, box: Box, probability: float) -> None:
        """See `ResponseTracker`."""
        learn = partial(self._response.learn, image, box, probability)
        self._guard.run(learn, None, lambda _: True)


def _is_estimate(answer: MotionEstimate) -> bool:
    sound = isinstance(answer, MotionEstimate) and isinstance(answer.box, Box)
    return sound and math.isfinite(answer.confidence) and answer.confidence <= SURE


def _channels(answer: ResponseMap) -> int:
    return 0 if answer.image_features is None else answer.image_features.shape[2]


def _is_response(answer: ResponseMap) -> bool:
    if not isinstance(answer, ResponseMap) or not isinstance(answer.region, Box):
        return False
    places, features, second = answer.scores.size, answer.image_features, answer.second
    shapes = answer.corners.shape, answer.scores.shape, answer.penalty.shape
    if not places or shapes != ((places, 4), (places,), (places,)):
        return False
    if second is not None and not _is_estimate(second):
        return False
    if features is not None and (features.ndim != 3 or not np.isfinite(features).all()):
        return False
    surest = max(answer.scores.max(), answer.penalty.max())
    finite = answer.finite(answer.region) is answer
    return finite and bool(surest <= SURE and answer.penalty.min() >= 0)
