"""Where the motion tracker looks, and how often."""

from __future__ import annotations

from follower_vision.box import Box
from follower_vision.frame import Frame
from follower_vision.fusion.belief import Belief
from follower_vision.fusion.evidence import SURE
from follower_vision.fusion.forecasts import CALM_SIZES
from follower_vision.fusion.rivals import LEAST_SHARE
from follower_vision.fusion.scanning import around
from follower_vision.fusion.settings import FusionSettings
from follower_vision.fusion.steering import (
    CandidateTracker,
    CorrectableTracker,
    ProbingTracker,
    SteerableTracker,
)
from follower_vision.fusion.trust import Trust
from follower_vision.motion import MotionEstimate, MotionTracker
from follower_vision.track import TrackState

_NEAR_SIZES = 0.75
_STEP_SIZES = 2.0


class Gaze:
    """Sends a motion tracker to where the target should be, one look a frame if possible."""

    def __init__(self, motion: MotionTracker, settings: FusionSettings) -> None:
        self._motion = motion
        self._settings = settings
        # Asked once: a protocol's isinstance takes longer than the rest of a step's logic.
        self._steerable = motion if isinstance(motion, SteerableTracker) else None
        self._probing = motion if isinstance(motion, ProbingTracker) else None
        self._correctable = motion if isinstance(motion, CorrectableTracker) else None
        self._rivalled = motion if isinstance(motion, CandidateTracker) else None
        self._ahead: tuple[Frame, Box, MotionEstimate] | None = None
        self._ahead_in_vain = False
        self._turns = 0
        self._unsure = 0

    @property
    def ahead_in_vain(self) -> bool:
        """Whether the camera's motion showed that the target was elsewhere in the last frame."""
        return self._ahead_in_vain

    def learn(self, frame: Frame, box: Box) -> None:
        """Let the tracker learn a target anew."""
        self._motion.start(frame.image, box)
        self._ahead = None
        self._ahead_in_vain = False
        self._turns = self._unsure = 0

    def turn_to(self, frame: Frame, box: Box) -> None:
        """Go on from another place; in the paper's way, learning anew what is there."""
        if self._steerable is None or not self._settings.keep_template:
            self._motion.start(frame.image, box)
        elif self._correctable is not None:
            self._correctable.correct(frame.image, box)
        else:
            self._steerable.move_to(box)

    def look_ahead(self, frame: Frame, belief: Belief, doubting: bool) -> MotionEstimate | None:
        """Look where the target mostly is, before the camera's motion is known; say what is seen.

        Args:
            frame: the next frame.
            belief: still that of the last frame.
            doubting: whether a box in doubt is followed.
        """
        self._ahead = None
        if self._steerable is not None and not self._searching(belief, doubting):
            place = belief.place_ahead()
            self._ahead = frame, place, _looked(self._steerable, frame, place)
        return None if self._ahead is None else self._ahead[2]

    def estimate(
        self, frame: Frame, belief: Belief, expected: Box | None, usual: Trust, doubting: bool
    ) -> MotionEstimate:
        """Return the tracker's answer; what it said ahead if that was about the right place.

        Where it was not quite, and the tracker is unsure, it looks again.

        Args:
            frame: the next frame.
            belief: brought to this frame.
            expected: where the target should be; None if that is where the box went.
            usual: what the tracker's confidence is worth.
            doubting: whether a box in doubt is followed.
        """
        if self._steerable is None:
            return self._motion.update(frame.image)
        ahead, self._ahead = self._ahead, None
        if expected is not None and self._searching(belief, doubting):
            return _looked(self._steerable, frame, self._place_of_turn(frame, expected))
        self._turns = 0
        wanted = belief.box if expected is None else expected
        place = belief.about_ahead(wanted)
        self._ahead_in_vain = place is not belief.ahead
        known = ahead is not None and ahead[0] is frame and ahead[1] == place
        estimate = ahead[2] if ahead and known else _looked(self._steerable, frame, place)
        calm = place.distance(wanted) < CALM_SIZES * wanted.scale
        if calm or usual.relative(estimate.confidence) >= SURE:
            return estimate
        seen = belief.state is TrackState.TRACKING
        self._unsure = 0 if seen else self._unsure + 1
        # What was not to be seen lately need not be looked for at two places in each frame.
        return estimate if self._unsure % 2 else _looked(self._steerable, frame, wanted)

    def settled(self, belief: Belief, expected: Box, estimate: MotionEstimate) -> MotionEstimate:
        """Go back to the target if the motion tracker went with a look-alike."""
        wanted = self._settings.distractor_memory
        if not wanted or self._rivalled is None or self._steerable is None:
            return estimate
        others = self._rivalled.candidates(LEAST_SHARE * estimate.confidence)
        settled = belief.rivals.settle(expected, estimate, others)
        belief.strangers.meet(belief.rivals.standing, belief.history)
        if settled is not estimate:
            self._steerable.move_to(settled.box)
            if settled.confidence > 0:
                belief.kinematics.restart(settled.box)
        return settled

    def probe(self, frame: Frame, expected: Box) -> MotionEstimate | None:
        """Look for the target where it should be, without going there."""
        if self._probing is None:
            return None
        reach_px = _NEAR_SIZES * expected.scale
        places = self._probing.probe(frame.image, expected)
        near = [place for place in places if place.box.distance(expected) <= reach_px]
        return near[0] if near else None

    def _searching(self, belief: Belief, doubting: bool) -> bool:
        """Whether the motion tracker looks all around, because no detector does."""
        lost = belief.state is TrackState.LOST and not doubting
        return lost and not belief.familiar and self._settings.growing_search

    def _place_of_turn(self, frame: Frame, expected: Box) -> Box:
        """Every second time where the target is expected, else at one place after the other."""
        self._turns += 1
        if self._turns % 2 == 0:
            return expected
        step_px = _STEP_SIZES * expected.scale
        return around(expected, step_px, self._turns // 2, frame.width, frame.height)


def _looked(motion: SteerableTracker, frame: Frame, place: Box) -> MotionEstimate:
    motion.move_to(place)
    return motion.update(frame.image)
