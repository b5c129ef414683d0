"""Two motion trackers that search together."""

import numpy as np

from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.trackers.motion_tracker import (
    MotionEstimate,
    MotionTracker,
    ResponseMap,
    ResponseTracker,
)


class PairedTracker:
    """Searches with two motion trackers; Fusion weighs the places of both.

    What the first says of a place counts as the likeness to the target at the start, what the
    second says as the likeness to it lately. Alone, as a motion tracker, it is the first of them.

    Args:
        first: searches.
        second: searches too.
        name: for tables and logs.

    Raises:
        TypeError: one of them names its best place alone.
    """

    def __init__(self, first: MotionTracker, second: MotionTracker, name: str) -> None:
        if not isinstance(first, ResponseTracker) or not isinstance(second, ResponseTracker):
            raise TypeError("only trackers that answer with a response map can be paired")
        self._motion = first
        self._other = second
        self._responses: tuple[ResponseTracker, ResponseTracker] = (first, second)
        self.name = name

    def start(self, image: Image, box: Box) -> None:
        """Learn the target anew from its box in `image`, (H, W, 3) uint8 BGR."""
        self._motion.start(image, box)
        self._other.start(image, box)

    def update(self, image: Image) -> MotionEstimate:
        """Find the target by the first tracker alone."""
        return self._motion.update(image)

    def search(self, image: Image, box: Box) -> ResponseMap:
        """See `ResponseTracker`: the places of both."""
        one, two = (tracker.search(image, box) for tracker in self._responses)
        return ResponseMap(
            np.vstack([one.corners, two.corners]),
            np.concatenate([one.first, np.zeros(len(two.first))]),
            np.concatenate([np.zeros(len(one.first)), two.first]),
            np.concatenate([one.penalty, two.penalty]),
            one.region,
            one.image_features,
        )

    def learn(self, image: Image, box: Box, probability: float) -> None:
        """See `ResponseTracker`."""
        for tracker in self._responses:
            tracker.learn(image, box, probability)
