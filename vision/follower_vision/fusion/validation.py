"""Compares the track with what the detector sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from follower_vision.box import Box
from follower_vision.detection.detection import Detection
from follower_vision.frame import Frame, Image
from follower_vision.fusion.belief import SAME_IOU, Belief, towards
from follower_vision.fusion.following import Following
from follower_vision.fusion.history import Moment
from follower_vision.fusion.looks import Looks
from follower_vision.fusion.neighbours import (
    Neighbours,
    assign_target,
    claimed_boxes,
    likeness,
)
from follower_vision.fusion.parting import Parting
from follower_vision.fusion.settings import FusionSettings
from follower_vision.track import TrackState

_SIZE_CHANGE = 2.0
_REACH_SIZES = 0.35
_REACH_SIZES_S = 0.8
_TRAJECTORY_S = 1.0
_LEAST_NEARNESS = 0.4
_AGREEMENT = 0.5
_CLEAR = 0.4
_CLOSE = 0.7
_CLOSER = 0.6
_STEADY_LOOKS = 2
_ESTRANGED_LOOKS = 3
_CONFIDENT = 0.95
_LEAST_LOOKS = 0.4
_USUAL_LOOKS = 0.85


@dataclass(frozen=True, slots=True)
class Sight:
    """What the detector saw of the target's kind in one frame of the history.

    Attributes:
        moment: the frame.
        boxes: the target's box for each detection, if that is the target.
        detections: the detections.
    """

    moment: Moment
    boxes: Sequence[Box]
    detections: Sequence[Detection]


class Validation:
    """Decides which detection is the target, corrects the track, and counts failures."""

    def __init__(self, settings: FusionSettings, following: Following, looks: Looks) -> None:
        self._settings = settings
        self._following = following
        self._looks = looks
        self.neighbours = Neighbours()
        self._parting = Parting()
        self._misses = 0
        self._estranged = 0
        self._agreed = 0
        self._disagreed = False

    @property
    def steady(self) -> bool:
        """Whether detector and motion tracker have agreed lately, with nobody else about."""
        return self._agreed >= _STEADY_LOOKS and not self.neighbours.known

    def elsewhere(self, belief: Belief, looks: int) -> tuple[Box, float] | None:
        """Return where a look may show the target if it is not what is followed, or None.

        What may be the target by a look is looked at at once. Every second look is at where it
        should be by what was foretold, if the track fits that badly; or it is a closer one, if
        somebody like the target is about, whom the detector may take together with it for one. Only
        where others know of the target's way is any of this done, for that alone tells them apart.

        Args:
            belief: of the target.
            looks: how many were taken before this one.

        Returns:
            The place, and how many usual crops wide the look is.
        """
        suspect = self._parting.suspect(belief)
        if suspect is not None:
            return suspect, 1.0
        told = belief.prospect is not None or belief.earlier
        if not (told and self._settings.distractor_memory) or looks % 2 == 0:
            return None
        foretold = self._parting.foretold(belief)
        if foretold is not None:
            return foretold, 1.0
        crowded = bool(self.neighbours.known) or self._disagreed
        return (belief.box, _CLOSER) if crowded else None

    def suspects(self, belief: Belief) -> bool:
        """Whether one more look may show that what is followed is not the target."""
        return self._parting.suspect(belief) is not None

    def start(self) -> None:
        """Forget the look-alikes and the failures: another target, or the same found again."""
        self.neighbours = Neighbours()
        self._parting = Parting()
        self._misses = 0
        self._estranged = 0
        self._agreed = 0
        self._disagreed = False

    def validate(
        self, frame: Frame, belief: Belief, sight: Sight, image: Image, covered: bool = True
    ) -> None:
        """Correct the belief by a sight that is of this frame or a little late.

        Args:
            frame: the present frame.
            belief: of the target.
            sight: what was seen.
            image: in which.
            covered: whether the look was at the track; of one elsewhere it is no failure that the
                target was not seen.
        """
        values = [self._value(belief, sight.moment, box) for box in sight.boxes]
        chosen = self._choose(values, belief, sight)
        agreed = chosen is not None and sight.boxes[chosen].iou(sight.moment.box) >= _CLOSE
        if self._settings.distractor_memory and self._parted(frame, belief, sight, chosen):
            return
        if chosen is None and not covered:
            return
        self._agreed, self._disagreed = self._agreed + 1 if agreed else 0, not agreed
        if self._settings.distractor_memory and self._ambiguous(values, chosen):
            return
        if self._settings.distractor_memory:
            rest = [box for number, box in enumerate(sight.boxes) if number != chosen]
            strangers = rest if chosen is not None else []
            self.neighbours.see(rest, strangers, belief.history, sight.moment)
        if chosen is None or not self._credible(image, belief, sight, sight.boxes[chosen]):
            self._missed(frame, belief)
        else:
            self._misses = 0
            self._confirm(frame, belief, sight.moment, sight.boxes[chosen])

    def _parted(self, frame: Frame, belief: Belief, sight: Sight, chosen: int | None) -> bool:
        """Go back to the target if a look-alike that came close was followed away from it."""
        moment = sight.moment
        followed = moment.box if chosen is None else sight.boxes[chosen]
        self.neighbours.meet(followed, belief.history, moment)
        parted = self._parting.parted(belief, moment, sight.boxes, followed, self.neighbours)
        if parted is None:
            return False
        box, since_s = parted
        self.neighbours = Neighbours()
        others = [one for one in sight.boxes if one is not box]
        self.neighbours.see(others, others, belief.history, moment)
        self._misses = 0
        belief.distrust_prospects(since_s)
        self._confirm(frame, belief, moment, box, another=True)
        return True

    def _credible(self, image: Image, belief: Belief, sight: Sight, box: Box) -> bool:
        """Whether a detection looks like the target.

        Where it is just what a confident motion tracker follows, the looks may have changed; not so
        where the tracker may have gone over to another thing of the target's kind.
        """
        if not self._settings.appearance_check:
            return True
        score = self._looks.score(image, box)
        if self._following.broken:
            return self._looks.relative(score) >= self._settings.doubt_ratio
        agreed = box.iou(sight.moment.box) >= _AGREEMENT and belief.confidence >= _CONFIDENT
        least = _LEAST_LOOKS if agreed else self._settings.doubt_ratio
        return score >= self._looks.epsilon or self._looks.relative(score) >= least

    def _whole(self, frame: Frame, box: Box) -> bool:
        """Whether the target is to be seen as usual: half of it may be hidden already."""
        if not self._settings.appearance_check:
            return True
        return self._looks.relative(self._looks.score(frame.image, box)) >= _USUAL_LOOKS

    def unclaimed(self, belief: Belief, sight: Sight) -> list[Box]:
        """Return the boxes that can be a lost target's, and follow the look-alikes among them.

        Left out are known look-alikes', other targets', and those where the target is not to be
        expected. Whoever is seen where it cannot be is a look-alike from then on; whoever is seen
        elsewhere while it is waited for, until the waiting is over.
        """
        places = [(box, belief.present(sight.moment, box)) for box in sight.boxes]
        likely = [box for box, present in places if belief.is_likely(present)]
        if not self._settings.distractor_memory:
            return likely
        claimed = claimed_boxes(sight.boxes, self._claims(belief, sight))
        strangers = [box for box, present in places if not belief.is_possible(present)]
        passers = [box for box in sight.boxes if box not in likely and box not in strangers]
        others = [box for box in sight.boxes if box in claimed or box not in likely]
        self.neighbours.see(others, strangers, belief.history, sight.moment, passers)
        return [box for box in likely if all(box.iou(other) < SAME_IOU for other in claimed)]

    def _choose(self, values: list[float], belief: Belief, sight: Sight) -> int | None:
        if not self._settings.distractor_memory:
            return assign_target(values, [])
        return assign_target(values, self._claims(belief, sight))

    def _claims(self, belief: Belief, sight: Sight) -> list[list[float]]:
        """How well each look-alike and other target (rows) explains each box (columns)."""
        known = self.neighbours.claims(sight.boxes, belief.history, sight.moment, belief.waits)
        return known + [
            [box.iou(other) if box.iou(other) >= SAME_IOU else 0.0 for box in sight.boxes]
            for other in belief.taken
        ]

    def _ambiguous(self, values: list[float], chosen: int | None) -> bool:
        """Whether another detection fits about as well: then the motion tracker knows better."""
        if chosen is None:
            return False
        others = [value for number, value in enumerate(values) if number != chosen]
        return max(others, default=0.0) > max(0.0, values[chosen] - _CLEAR)

    def _value(self, belief: Belief, moment: Moment, box: Box) -> float:
        """How much a box is the target by its place: the motion tracker's, and the trajectory's."""
        tracked = belief.state is TrackState.TRACKING
        present = belief.present(moment, box)
        if not (belief.is_possible(present) if tracked else belief.is_likely(present)):
            return 0.0
        age_s = moment.captured_s - belief.confirmation.moment.captured_s
        expected = belief.confirmation.expected(belief.history, moment)
        if not 1 / _SIZE_CHANGE < box.scale / expected.scale < _SIZE_CHANGE:
            return 0.0
        overlap = box.iou(moment.box)
        reach_px = expected.scale * (_REACH_SIZES + _REACH_SIZES_S * age_s)
        near = likeness(expected, box, reach_px) if age_s < _TRAJECTORY_S else 0.0
        if overlap < self._settings.match_iou and near < _LEAST_NEARNESS:
            return 0.0
        return 0.5 * overlap + 0.5 * near

    def _missed(self, frame: Frame, belief: Belief) -> None:
        self._misses += 1
        if self._misses < self._settings.misses_to_lose:
            return
        if not self._settings.appearance_check or self._unlike(frame, belief):
            belief.state = TrackState.LOST
            belief.produced_by = "lost"

    def _unlike(self, frame: Frame, belief: Belief) -> bool:
        """Whether the track's box looks neither like the templates nor as it did lately."""
        if self._following.doubting:
            return False
        score = self._looks.score(frame.image, belief.box)
        settings = self._settings
        return score < settings.doubt_score and self._looks.relative(score) < settings.doubt_ratio

    def _confirm(
        self, frame: Frame, belief: Belief, moment: Moment, box: Box, another: bool = False
    ) -> None:
        """Believe a box; as it is if it is of another than the one followed up to now."""
        settings = self._settings
        present = belief.present(moment, box)
        share = 1.0 if another else settings.size_share
        belief.reference = towards(belief.reference, present, share)
        corrected = present
        if settings.keep_template and not another and box.iou(moment.box) >= settings.match_iou:
            corrected = self._blended(belief, moment, box)
        estranged = belief.confidence < settings.low_ratio
        self._estranged = self._estranged + 1 if estranged else 0
        belief.see(corrected, max(belief.confidence, 0.5), "detector")
        belief.kinematics.correct(corrected)
        belief.confirm(moment, box)
        if estranged or self._whole(frame, corrected):
            belief.anchor()
        if self._estranged >= _ESTRANGED_LOOKS:
            self._following.teach(frame, corrected)
            self._estranged = 0
        else:
            self._following.relocate(frame, corrected)

    def _blended(self, belief: Belief, moment: Moment, box: Box) -> Box:
        """Shift the present box by what the past one was off, in part."""
        settings = self._settings
        warp = belief.history.warp(moment, belief.now)
        right, down = warp.turn(box.cx - moment.box.cx, box.cy - moment.box.cy)
        share = settings.position_share if belief.state is TrackState.TRACKING else 1.0
        sized = towards(belief.box, box, settings.size_share)
        return sized.moved_to(sized.cx + share * right, sized.cy + share * down)
