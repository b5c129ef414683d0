"""Remembers what the target looks like, and recognises it."""

from __future__ import annotations

from follower_vision.box import Box
from follower_vision.embedding import Embedder, Gallery
from follower_vision.frame import Frame, Image
from follower_vision.fusion.trust import Trust
from follower_vision.reidentify import Reidentifier, ReidentifySettings
from follower_vision.targetsearch import TargetSearch

_REFRESH_S = 0.5
_RISE_S = 0.5
_FALL_S = 2.5
_FRESH_SHARE = 0.8
_KIN_COSINE = 0.675
_KIN_WEIGHT = 3.0
_LOOK_EVERY_S = 0.08
_SAME_PLACE_IOU = 0.5


class Looks:
    """Re-identification, and the search by looks."""

    def __init__(self, settings: ReidentifySettings, embedder: Embedder | None = None) -> None:
        """Make one that knows nothing yet; an appearance network may help it."""
        self._settings = settings
        self._gallery = None if embedder is None else Gallery(embedder)
        self._reidentifier = Reidentifier(settings)
        self._search = TargetSearch()
        self._view: tuple[Image, Box] | None = None
        self._refreshed_s = 0.0
        self._usual = Trust(_RISE_S, _FALL_S)
        self._noticed: tuple[float, Box, float] | None = None

    @property
    def epsilon(self) -> float:
        """The least score of the target."""
        return self._settings.epsilon

    def start(self, frame: Frame, box: Box) -> None:
        """Forget everything and learn another target."""
        self._reidentifier.start(frame.image, box, frame.captured_s)
        self._view = frame.image, box
        if self._gallery is not None:
            self._gallery.start(frame.image, box)
        self._refreshed_s = frame.captured_s
        self._usual = Trust(_RISE_S, _FALL_S)
        self._noticed = None

    def relative(self, score: float) -> float:
        """Return a score as a share of what is usual for the target, at most 1."""
        return self._usual.relative(score)

    def get_used(self, score: float, interval_s: float) -> None:
        """Take the score of a box believed; `interval_s` since the last one."""
        self._usual.learn(score, interval_s)

    def notice(self, score: float, box: Box, captured_s: float) -> None:
        """Remember the score of a box that looked as usual."""
        self._noticed = score, box, captured_s

    def recent(self, box: Box, captured_s: float) -> float | None:
        """Return that score if it is less than 0.08 s old and of about the same place."""
        if self._noticed is None:
            return None
        score, seen, seen_s = self._noticed
        again = captured_s - seen_s >= _LOOK_EVERY_S or box.iou(seen) < _SAME_PLACE_IOU
        return None if again else score

    def accept(self, frame: Frame, box: Box) -> None:
        """Take what a box shows as the target's new look, and as usual from now on."""
        if self._settings.max_recent:
            self._reidentifier.refresh(frame.image, box)
        # A view just learnt fits better than any later one will.
        self._usual.reset(_FRESH_SHARE * self.score(frame.image, box))

    def learn(self, frame: Frame, box: Box, score: float) -> None:
        """Take a view of the target: the first second's for good, later ones for a while.

        Args:
            frame: where it is to be seen.
            box: the target.
            score: the box's re-identification score; a poor view is not learnt.
        """
        if score < self.epsilon:
            return
        self._reidentifier.learn(frame.image, box, frame.captured_s)
        if frame.captured_s - self._refreshed_s < _REFRESH_S:
            return
        self._refreshed_s = frame.captured_s
        self._view = frame.image, box
        if self._gallery is not None:
            self._gallery.learn(frame.image, box)
        if self._settings.max_recent:
            self._reidentifier.refresh(frame.image, box)

    def score(self, image: Image, box: Box) -> float:
        """Return how much a box shows the target, -1 to 2."""
        return self._reidentifier.score(image, box)

    def kinship(self, image: Image, box: Box) -> float:
        """Return what the appearance network adds to a candidate's score; 0 without one.

        With OSNet the cosine of two views of one person is about 0.80, of two persons 0.55.
        """
        if self._gallery is None:
            return 0.0
        return _KIN_WEIGHT * (self._gallery.likeness(image, box) - _KIN_COSINE)

    def proposals(self, image: Image, expected: Box, reach_px: float) -> list[Box]:
        """Return places where the target might be by its looks alone, in a bounded time."""
        if self._view is not None:
            # Learnt here and not when it was seen: most views are never searched for.
            self._search.learn(*self._view)
            self._view = None
        return self._search.everywhere(image, expected, reach_px)
