"""Finds a lost target again."""

from __future__ import annotations

from follower_vision.box import Box
from follower_vision.frame import Frame, Image
from follower_vision.fusion.belief import Belief
from follower_vision.fusion.following import Following
from follower_vision.fusion.looks import Looks
from follower_vision.fusion.settings import FusionSettings
from follower_vision.fusion.validation import Sight, Validation

_REACH_SIZES = 3.0
_UNFAMILIAR_REACH_SIZES = 4.0
_UNFAMILIAR_MARGIN = 0.25


class Finding:
    """Re-identifies the target among detections, or by its looks alone."""

    def __init__(
        self, settings: FusionSettings, following: Following, validation: Validation, looks: Looks
    ) -> None:
        self._settings = settings
        self._following = following
        self._validation = validation
        self._looks = looks

    def among(self, frame: Frame, belief: Belief, sight: Sight, image: Image) -> bool:
        """Look for the target among detections; return whether it is found."""
        found = self._looks.best(
            image, [box for box in sight.boxes if self._plausible(belief, sight, box)]
        )
        if found is None:
            return False
        belief.kinematics.stop(found[0])
        self._resume(frame, belief, belief.present(sight.moment, found[0]), found[1])
        belief.confirm(sight.moment, found[0])
        return True

    def unaided(self, frame: Frame, belief: Belief, expected: Box) -> bool:
        """Look for a target that no detector knows; return whether it is found."""
        growth = self._settings.search_growth_s * belief.unseen_s
        reach_px = expected.scale * (_UNFAMILIAR_REACH_SIZES + growth)
        found = self._looks.search(frame.image, expected, reach_px)
        if found is None or found[1] < self._looks.epsilon + _UNFAMILIAR_MARGIN:
            return False
        self._resume(frame, belief, found[0], found[1])
        return True

    def _plausible(self, belief: Belief, sight: Sight, box: Box) -> bool:
        settings = self._settings
        age_s = sight.moment.captured_s - belief.seen_s
        change = box.scale / belief.reference.scale
        if not 1 / settings.size_change_found < change < settings.size_change_found:
            return False
        reach = _REACH_SIZES + settings.search_growth_s * age_s
        return box.distance(sight.moment.box) < belief.reference.scale * reach

    def _resume(self, frame: Frame, belief: Belief, box: Box, score: float) -> None:
        belief.see(box, min(1.0, score / 2), "reacquired")
        belief.reference = box
        belief.kinematics.stop(box)
        self._following.relocate(frame, box)
        self._validation.start()
