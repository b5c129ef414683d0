"""Remembers what the target looks like, and recognises it."""

from __future__ import annotations

from collections.abc import Sequence

from follower_vision.box import Box
from follower_vision.frame import Frame, Image
from follower_vision.reidentify import Reidentifier, ReidentifySettings
from follower_vision.targetsearch import TargetSearch

_REFRESH_S = 0.5


class Looks:
    """Re-identification, and the search by looks for targets that no detector knows."""

    def __init__(self, settings: ReidentifySettings) -> None:
        self._settings = settings
        self._reidentifier = Reidentifier(settings)
        self._search = TargetSearch()
        self._refreshed_s = 0.0

    @property
    def epsilon(self) -> float:
        """The least score of the target."""
        return self._settings.epsilon

    def start(self, frame: Frame, box: Box) -> None:
        """Forget everything and learn another target."""
        self._reidentifier.start(frame.image, box, frame.captured_s)
        self._search.learn(frame.image, box)
        self._refreshed_s = frame.captured_s

    def learn(self, frame: Frame, box: Box, sure: bool) -> None:
        """Take a view of the target: the first second's for good, later ones for a while."""
        self._reidentifier.learn(frame.image, box, frame.captured_s)
        if not sure or frame.captured_s - self._refreshed_s < _REFRESH_S:
            return
        self._refreshed_s = frame.captured_s
        self._search.learn(frame.image, box)
        if self._settings.max_recent and self.score(frame.image, box) >= self.epsilon:
            self._reidentifier.refresh(frame.image, box)

    def score(self, image: Image, box: Box) -> float:
        """Return how much a box shows the target, -1 to 2."""
        return self._reidentifier.score(image, box)

    def best(self, image: Image, boxes: Sequence[Box]) -> tuple[Box, float] | None:
        """Return the box that shows the target best, if one does, and its score."""
        return self._reidentifier.best(image, boxes)

    def search(self, image: Image, expected: Box, reach_px: float) -> tuple[Box, float] | None:
        """Look for the target by its looks alone, in a bounded time."""
        return self.best(image, self._search.everywhere(image, expected, reach_px))
