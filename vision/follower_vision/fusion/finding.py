"""Finds a lost target again."""

from __future__ import annotations

import math
from collections.abc import Sequence

from follower_vision.box import Box
from follower_vision.frame import Frame, Image
from follower_vision.fusion.belief import Belief
from follower_vision.fusion.following import Following
from follower_vision.fusion.history import Moment
from follower_vision.fusion.looks import Looks
from follower_vision.fusion.settings import FusionSettings
from follower_vision.fusion.sole import Sole
from follower_vision.fusion.validation import Sight, Validation

_REACH_SIZES = 3.0
_UNFAMILIAR_REACH_SIZES = 4.0
_ALIKE = 0.68
_ALIKE_IF_STRANGE = 0.5
_ALIKE_IF_ALONE = 0.6
_FAR = 0.25
_SIZE_WEIGHT = 0.3
_SURELY_ALIKE = 0.85
_FORESEEN = 0.3
"""Who is where the target should come out, and nobody known, need not look quite like it."""
_MARGIN = 0.1
_SAME_PLACE_IOU = 0.3


class Finding:
    """Re-identifies the target among detections, or by its looks alone."""

    def __init__(
        self, settings: FusionSettings, following: Following, validation: Validation, looks: Looks
    ) -> None:
        self._settings = settings
        self._following = following
        self._validation = validation
        self._looks = looks
        self._suspect: tuple[Moment, Box] | None = None
        self._sole = Sole()

    def forget(self) -> None:
        """Begin anew with another target."""
        self._suspect = None
        self._sole.forget()

    def suspect(self, belief: Belief) -> Box | None:
        """Return where the likeliest of the last look's strangers is now.

        In the whole image, reduced to the detector's size, its box may have been too loose to
        recognise the target in it; a closer look will tell.
        """
        if self._suspect is None or belief.history.at(self._suspect[0].index) is None:
            return None
        return belief.present(*self._suspect)

    def among(self, frame: Frame, belief: Belief, sight: Sight, image: Image) -> bool:
        """Look for the target among detections; return whether it is found."""
        free = self._validation.unclaimed(belief, sight)
        scored = [(self._looks.score(image, box), box) for box in free]
        scored.sort(key=lambda one: -one[0])
        alone = self._alone(belief, sight.moment, scored)
        recognised = self._recognised(image, belief, scored, sight.moment)
        found = recognised or alone
        if found is None:
            self._suspect = (sight.moment, scored[0][1]) if scored else None
            return False
        box, score = found
        belief.kinematics.restart(box)
        self._resume(frame, belief, belief.present(sight.moment, box), score)
        belief.confirm(sight.moment, box)
        if recognised is None:
            self._looks.accept(frame, belief.box)
            belief.witness.overrule()
        return True

    def _alone(
        self, belief: Belief, moment: Moment, scored: Sequence[tuple[float, Box]]
    ) -> tuple[Box, float] | None:
        """Return the only candidate there is, with its score, if it looks about like the target."""
        if not self._settings.growing_search:
            return None
        reach_px = belief.reference.scale * _REACH_SIZES
        persists = self._sole.persists(scored, moment, belief.history, reach_px)
        if not persists or self._looks.relative(scored[0][0]) < _ALIKE_IF_ALONE:
            return None
        score, box = scored[0]
        # Whose way through the world is known cannot have come so much nearer or gone so far.
        strange = math.isinf(self._strangeness(belief, moment, box))
        return None if strange and belief.prospect is not None else (box, score)

    def unaided(self, frame: Frame, belief: Belief, expected: Box) -> bool:
        """Look for a target that no detector knows; return whether it is found."""
        growth = self._settings.search_growth_s * belief.unseen_s
        reach_px = expected.scale * (_UNFAMILIAR_REACH_SIZES + growth)
        boxes = self._looks.proposals(frame.image, expected, reach_px)
        boxes = [box for box in boxes if belief.is_likely(box)]
        if self._settings.distractor_memory:
            boxes = [box for box in boxes if not belief.refuse_stranger(box, expected)]
        scored = [(self._looks.score(frame.image, box), box) for box in boxes]
        found = self._recognised(frame.image, belief, scored, belief.now)
        if found is None:
            return False
        self._resume(frame, belief, *found)
        return True

    def _recognised(
        self, image: Image, belief: Belief, scored: Sequence[tuple[float, Box]], moment: Moment
    ) -> tuple[Box, float] | None:
        """Return the box that is the target, and its score, if one is.

        The further away and the more different in size, the better it has to look.
        """
        fits: list[tuple[float, Box, float]] = []
        for score, box in scored:
            strange = self._strangeness(belief, moment, box)
            lenience = self._looks.kinship(image, box) if belief.familiar else 0.0
            lenience += _FORESEEN if belief.prospect is not None else 0.0
            least = _ALIKE + _ALIKE_IF_STRANGE * (strange - lenience)
            if self._looks.relative(score) < least:
                continue
            value = score - strange + lenience
            if value >= self._looks.epsilon:
                fits.append((value, box, score))
        best = max(fits, key=lambda one: one[0], default=None)
        return None if best is None or self._ambiguous(best, fits) else best[1:]

    def _ambiguous(
        self, best: tuple[float, Box, float], fits: Sequence[tuple[float, Box, float]]
    ) -> bool:
        """Whether the best looks not quite like the target, and another one about as much."""
        value, box, score = best
        if not self._settings.distractor_memory or self._looks.relative(score) >= _SURELY_ALIKE:
            return False
        others = [one for one in fits if one[1].iou(box) < _SAME_PLACE_IOU]
        return any(one[0] > value - _MARGIN for one in others)

    def _strangeness(self, belief: Belief, moment: Moment, box: Box) -> float:
        settings = self._settings
        change = abs(math.log(box.scale / belief.reference.scale))
        reach = _REACH_SIZES + settings.search_growth_s * (moment.captured_s - belief.seen_s)
        away = box.distance(moment.box) / (belief.reference.scale * reach)
        if change > math.log(settings.size_change_found) or not settings.growing_search:
            return math.inf if change > math.log(settings.size_change_found) else 0.0
        return min(_FAR, _FAR * away) + _SIZE_WEIGHT * change

    def _resume(self, frame: Frame, belief: Belief, box: Box, score: float) -> None:
        self.forget()
        belief.see(box, min(1.0, score / 2), "reacquired")
        belief.reference = box
        belief.kinematics.restart(box)
        belief.anchor()
        self._following.relocate(frame, box)
        self._validation.start()
