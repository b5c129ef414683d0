"""A detector in the background, played in simulated time: the same every time."""

from __future__ import annotations

import math

from follower_vision.clock import Clock
from follower_vision.detection.detection import Detector
from follower_vision.fusion.detection_service import (
    REST_SHARES,
    DetectionAnswer,
    DetectionRequest,
    Need,
)


class LateDetection:
    """Answers after a fixed time by a clock handed in, and then rests as the real thread does."""

    def __init__(self, detector: Detector, clock: Clock, late_s: float) -> None:
        self._detector = detector
        self._clock = clock
        self._late_s = late_s
        self._due_s = -math.inf
        self._request: DetectionRequest | None = None

    def ready(self, need: Need = Need.USUAL) -> bool:
        """Tell whether the last answer was fetched and the rest is over."""
        rested = self._clock.now() >= self._due_s + REST_SHARES[need] * self._late_s
        return rested and self._request is None

    def submit(self, request: DetectionRequest) -> None:
        """Take a request, unless one is under way."""
        if self._request is None:
            self._request, self._due_s = request, self._clock.now() + self._late_s

    def take(self, owner: object) -> list[DetectionAnswer]:
        """Return the answer to one asker's request if it is due."""
        request = self._request
        if request is None or self._clock.now() < self._due_s:
            return []
        self._request = None
        if request.owner is not owner:
            return []
        return [DetectionAnswer(request, self._detector.detect(request.image, request.region))]

    def close(self) -> None:
        """Forget the request."""
        self._request = None
