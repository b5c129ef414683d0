"""Where in the image the detector looks."""

from __future__ import annotations

from follower_vision.box import Box
from follower_vision.frame import Frame
from follower_vision.fusion.belief import Belief
from follower_vision.fusion.finding import Finding
from follower_vision.fusion.looks import Looks
from follower_vision.fusion.scanning import around
from follower_vision.fusion.settings import FusionSettings
from follower_vision.track import TrackState

_LEAST_CROP_SIDES = 2.5
_CLOSE_CROPS, _EDGE_SIZES = 2.0, 1.5
_SMALL_SHARE = 0.05


class Regions:
    """A crop about a target that is seen; for a lost one a search.

    In the whole image, reduced to the detector's size, a small target may be too small to be seen.
    So in the search one small region after the other is looked at as closely as the target was
    while it was followed: what looks like it, and all others, the nearer ones first.

    Args:
        settings: of Fusion.
        finding: knows what has to be looked at more closely.
        looks: of the target.
    """

    def __init__(self, settings: FusionSettings, finding: Finding, looks: Looks) -> None:
        self._settings = settings
        self._finding = finding
        self._looks = looks
        self.start()

    def start(self) -> None:
        """Begin with another target."""
        self._looked_closely = 0

    def next(
        self, frame: Frame, belief: Belief, elsewhere: tuple[Box, float] | None = None
    ) -> Box | None:
        """Return where to look in this frame, None for the whole image; each call is a look.

        Args:
            frame: the present frame.
            belief: of the target.
            elsewhere: another place to look at than the track's, and how many usual crops wide.
        """
        settings = self._settings
        if belief.state is TrackState.LOST:
            return self._searched(frame, belief) if settings.growing_search else None
        self.start()
        if not settings.zoomed_validation:
            return None
        if elsewhere is not None and _is_in(elsewhere[0], frame):
            return self._about(frame, *elsewhere)
        return self._about(frame, belief.box)

    def _searched(self, frame: Frame, belief: Belief) -> Box | None:
        """Take turns: a growing region, a small one, the whole image.

        A very small target is looked for in small regions also when the growing one has become the
        whole image.
        """
        turn = belief.now.index // self._settings.search_every % 3
        if turn == 2:
            return None
        suspect = self._finding.suspect(belief)
        if suspect is not None:
            return self._about(frame, suspect)
        crops = 1 + belief.unseen_s * self._settings.search_growth_s / self._settings.crop_sizes
        grown = self._about(frame, belief.box, crops)
        small = belief.box.scale < _SMALL_SHARE * max(frame.width, frame.height)
        if crops <= _CLOSE_CROPS or (turn == 0 and (grown is not None or not small)):
            return grown
        return self._closely(frame, belief)

    def _closely(self, frame: Frame, belief: Belief) -> Box | None:
        """Look at what looks like the target, and at one place after the other, by turns."""
        close = self._about(frame, belief.box)
        if close is None:
            return None
        number, self._looked_closely = self._looked_closely, self._looked_closely + 1
        if number % 2 == 0:
            alike = self._looks.proposals(frame.image, belief.box, close.width)
            if alike:
                return self._about(frame, alike[number // 2 % len(alike)])
        # Neighbouring regions overlap, so that each place is far enough from the edges of one.
        step_px = close.width - _EDGE_SIZES * max(belief.box.width, belief.box.height)
        return around(close, step_px, number // 2, frame.width, frame.height)

    def _about(self, frame: Frame, place: Box, crops: float = 1.0) -> Box | None:
        """Return a region so many crops wide about a place; None if that is the whole image."""
        settings = self._settings
        least = _LEAST_CROP_SIDES * max(place.width, place.height)
        side = crops * max(settings.crop_least_px, settings.crop_sizes * place.scale, least)
        whole = side >= max(frame.width, frame.height)
        return None if whole else Box(place.cx, place.cy, side, side)


def _is_in(place: Box, frame: Frame) -> bool:
    return 0 <= place.cx <= frame.width and 0 <= place.cy <= frame.height
