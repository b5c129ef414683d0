"""Follows the target from frame to frame by a motion tracker, as far as it can be believed."""

from __future__ import annotations

from follower_vision.box import Box
from follower_vision.frame import Frame
from follower_vision.fusion.belief import Belief
from follower_vision.fusion.evidence import CERTAIN, SURE, Evidence, Judge
from follower_vision.fusion.gaze import Gaze
from follower_vision.fusion.looks import Looks
from follower_vision.fusion.settings import FusionSettings
from follower_vision.fusion.sizes import clamped, drawn, inside
from follower_vision.fusion.trust import Trust
from follower_vision.motion import MotionEstimate, MotionTracker
from follower_vision.track import TrackState

_LEAST_VISIBLE = 0.3
_VERY_CERTAIN = 0.995
_LESS_CERTAIN = 0.7
_OBJECTED = 4.0
_USUAL_LOOKS = 0.85
_HESITANT = 0.9
_LEAP_SIZES = 0.5
_JUMP_SIZES = 1.0
_JUMP_SIZES_EDGE = 0.5
_WHOLE = 0.85
_RIVAL_FRAMES = 2
_PAUSE = 2
_LATE_PAUSE = 4
_RESUME_SIZES = 1.5
_STEADY_SIZES = 0.75
_ANCHOR_LOOKS = 0.88
_NOTICED_LOOKS = 0.8
_CONFIDENCE_MEMORY_S = 2.0


class Following:
    """Runs the motion tracker, and coasts when it is unsure or its box looks like nothing known."""

    def __init__(self, motion: MotionTracker, settings: FusionSettings, looks: Looks) -> None:
        self._name = motion.name
        self._gaze = Gaze(motion, settings)
        self._settings = settings
        self._looks = looks
        self._judge = Judge(settings, looks.epsilon)
        self._confidence = Trust(_CONFIDENCE_MEMORY_S, _CONFIDENCE_MEMORY_S)
        self._low = 0
        self._steady_s = 0.0
        self._doubted_s: float | None = None
        self._rival_frames = 0
        self._doubts = 0
        self._broken = self._forlorn = False

    @property
    def doubting(self) -> bool:
        """Whether a confident motion tracker is followed whose box looks unlike the target."""
        return self._doubted_s is not None

    @property
    def broken(self) -> bool:
        """Whether a box that looks wrong may be another thing than the one seen last."""
        return self._broken

    def start(self, frame: Frame, box: Box) -> None:
        """Follow another target."""
        self._gaze.learn(frame, box)
        self._confidence = Trust(_CONFIDENCE_MEMORY_S, _CONFIDENCE_MEMORY_S)
        self._low = 0
        self._doubted_s = None
        self._steady_s = 0.0
        self._rival_frames = self._doubts = 0
        self._broken = self._forlorn = False

    def relocate(self, frame: Frame, box: Box) -> None:
        """Go on from another place; in the paper's way, learning anew what is there."""
        self._low = 0
        self._doubted_s = None
        self._gaze.turn_to(frame, box)

    def teach(self, frame: Frame, box: Box) -> None:
        """Learn the target anew: it has changed so much that the tracker no longer knows it."""
        self._low = 0
        self._doubted_s = None
        self._gaze.learn(frame, box)
        self._confidence = Trust(_CONFIDENCE_MEMORY_S, _CONFIDENCE_MEMORY_S)

    @property
    def looks_ahead_in_vain(self) -> bool:
        """Whether the motion tracker had to be sent elsewhere than where it mostly looks."""
        return self._gaze.ahead_in_vain

    def look_ahead(self, frame: Frame, belief: Belief) -> bool:
        """Run the motion tracker where it mostly looks, before the camera's motion is known.

        Args:
            frame: the next frame.
            belief: still that of the last frame.

        Returns:
            Whether it is sure of what it sees there.
        """
        seen = self._gaze.look_ahead(frame, belief, self.doubting)
        return seen is not None and self._confidence.relative(seen.confidence) >= SURE

    def follow(
        self, frame: Frame, belief: Belief, expected: Box, interval_s: float, blurred: bool
    ) -> None:
        """Find the target in the next frame and write down what to believe.

        Args:
            frame: the next frame.
            belief: already brought to this frame by the camera's motion.
            expected: where the target should be.
            interval_s: since the last frame.
            blurred: whether the target's neighbourhood is blurred.
        """
        evidence = self._evidence(frame, belief, expected, blurred)
        belief.confidence = evidence.relative
        if belief.state is TrackState.TRACKING:
            self._while_tracking(frame, belief, evidence, expected, interval_s)
        elif self._may_doubt(belief, evidence, interval_s):
            self._while_doubting(frame, belief, evidence, expected, interval_s)
        else:
            self._while_coasting(frame, belief, evidence, expected, interval_s)

    def _while_tracking(
        self, frame: Frame, belief: Belief, evidence: Evidence, expected: Box, interval_s: float
    ) -> None:
        settings = self._settings
        if _left(belief, evidence):
            self._low += 1
            self.coast(frame, belief, belief.return_to(expected), "coasting")
            return
        unsure = settings.score_coasting and evidence.relative < settings.low_ratio
        denied = belief.witness.denies and evidence.looks < _USUAL_LOOKS
        odd = self._judge.unlike(evidence) or self._exchanged(belief, evidence, expected)
        if not unsure and not denied and not odd:
            self._see(frame, belief, evidence, interval_s)
            return
        self._low += 1
        self._broken = self._broken or _breaks(frame, belief, evidence)
        belief.box = clamped(evidence.box, belief, self._settings)
        if self._low < settings.low_frames:
            return
        reference = belief.reference
        expected = belief.return_to_anchor()
        if unsure:
            self.coast(frame, belief, expected, "coasting")
        else:
            belief.reference = reference
            self._doubted_s = self._steady_s = 0.0
            self._forlorn = False
            self._rival_frames = self._doubts = 0
            self.coast(frame, belief, belief.box, "doubtful")

    def _exchanged(self, belief: Belief, evidence: Evidence, expected: Box) -> bool:
        """Whether a tracker that hesitated or jumped may have come back to another thing."""
        if not self._low or not self._broken:
            return False
        return not self._judge.alike(evidence) or self._strange(belief, evidence, expected)

    def _strange(self, belief: Belief, evidence: Evidence, expected: Box) -> bool:
        """Whether the box is rather that of a look-alike which stood beside the target."""
        known = self._settings.distractor_memory and evidence.relative >= self._settings.low_ratio
        return known and belief.refuse_stranger(evidence.box, expected)

    def _may_doubt(self, belief: Belief, evidence: Evidence, interval_s: float) -> bool:
        """Whether a box in doubt is still worth following.

        As long as the tracker is confident there is no better guess, however long that lasts.
        """
        if self._doubted_s is None:
            return False
        self._doubted_s += interval_s
        longer = _OBJECTED if belief.witness.objects else 1.0
        self._forlorn = self._doubted_s > self._settings.doubt_s * longer
        return evidence.relative >= self._settings.low_ratio and belief.is_possible(evidence.box)

    def _while_doubting(
        self, frame: Frame, belief: Belief, evidence: Evidence, expected: Box, interval_s: float
    ) -> None:
        """The motion tracker is confident, but its box does not look like the target.

        Either the target changed its looks, or something else came before it. In the first case
        the tracker stays confident; in the second the target comes out again where it should be.
        """
        weight = 1.0 if evidence.relative >= _VERY_CERTAIN else _LESS_CERTAIN
        if evidence.relative >= CERTAIN:
            self._steady_s += weight * interval_s
        elif evidence.relative < SURE:
            self._steady_s = 0.0
        belief.reference = drawn(belief.reference, evidence.box, interval_s)
        self._broken = self._broken or _breaks(frame, belief, evidence)
        insistent = not self._forlorn and self._insistent(belief, doubtful=True)
        if insistent:
            self._looks.accept(frame, evidence.box)
            belief.witness.overrule()
        # What looks like the target there by chance, after so long, may be another thing.
        lost_sight = self._forlorn and self._broken
        if insistent or (not lost_sight and self._recognised(belief, evidence)):
            self._see(frame, belief, evidence, interval_s)
            return
        rival = self._rival(frame, expected, evidence)
        if rival is not None and self._rival_frames >= _RIVAL_FRAMES:
            self._see(frame, belief, rival, interval_s)
            return
        self.coast(frame, belief, clamped(evidence.box, belief, self._settings), "doubtful")

    def _rival(self, frame: Frame, expected: Box, evidence: Evidence) -> Evidence | None:
        """Look for the target where it should be, every second time, until it is there.

        What became of its place is ever less certain, so later on it is every fourth time.
        """
        self._doubts += 1
        pause = _LATE_PAUSE if self._forlorn else _PAUSE
        if self._doubts % pause != 1 and not self._rival_frames:
            return None
        place = self._gaze.probe(frame, expected)
        rival = None if place is None else self._surer(frame, place, evidence)
        better = rival is not None and self._judge.surpasses(rival, evidence)
        self._rival_frames = self._rival_frames + 1 if better else 0
        return rival

    def _surer(self, frame: Frame, place: MotionEstimate, evidence: Evidence) -> Evidence | None:
        """Look closely at another place, unless the tracker is less sure of it anyway."""
        surer = self._judge.rivals(self._confidence.relative(place.confidence), evidence)
        return self._judged(frame, place, False) if surer else None

    def _while_coasting(
        self, frame: Frame, belief: Belief, evidence: Evidence, expected: Box, interval_s: float
    ) -> None:
        self._doubted_s = None
        away = expected.distance(evidence.box) / expected.scale
        near = away <= _RESUME_SIZES + self._settings.search_growth_s * belief.unseen_s
        sure = evidence.relative >= self._settings.resume_ratio
        steady = away <= _STEADY_SIZES and evidence.relative >= SURE
        self._steady_s = self._steady_s + interval_s if steady else 0.0
        strange = self._strange(belief, evidence, expected)
        free = belief.is_free(evidence.box) and belief.is_likely(evidence.box) and not strange
        if self._settings.score_coasting and sure and near and free:
            estimate = MotionEstimate(evidence.box, evidence.confidence)
            evidence = self._judged(frame, estimate, evidence.blurred)
            # Sent to where a target should come out, a tracker insists on whatever hides it.
            sent = belief.familiar and belief.waits
            if self._recognised(belief, evidence) or (not sent and self._insistent(belief)):
                self._see(frame, belief, evidence, interval_s)
                return
        self.coast(frame, belief, expected, "coasting")

    def _insistent(self, belief: Belief, doubtful: bool = False) -> bool:
        """Whether the tracker has been certain for long.

        It takes longer if the detector objects, or if the tracker may have gone over to something
        else meanwhile.
        """
        longer = belief.witness.objects or (doubtful and self._broken)
        return self._steady_s > self._settings.insist_s * (_OBJECTED if longer else 1.0)

    def _recognised(self, belief: Belief, evidence: Evidence) -> bool:
        """Whether a box looks so much like the target that doubt ends."""
        denied = belief.witness.denies and evidence.looks < _ANCHOR_LOOKS
        return self._judge.alike(evidence) and not denied

    def coast(self, frame: Frame, belief: Belief, expected: Box, why: str) -> None:
        """The target is not seen: extrapolate for a while, then it is lost."""
        belief.box = inside(expected, frame)
        gone = expected.visible_share(frame.width, frame.height) < _LEAST_VISIBLE
        late = belief.unseen_s > self._settings.coast_s
        if belief.state is TrackState.LOST or gone or late:
            belief.state = TrackState.LOST
            belief.produced_by = "lost" if why == "coasting" else why
        else:
            belief.state = TrackState.COASTING
            belief.produced_by = why

    def _evidence(self, frame: Frame, belief: Belief, expected: Box, blurred: bool) -> Evidence:
        wanted = None if self._low == 1 or self.doubting else expected
        estimate = self._gaze.estimate(frame, belief, wanted, self._confidence, self.doubting)
        if belief.state is TrackState.TRACKING:
            estimate = self._gaze.settled(belief, expected, estimate)
        return self._judged(frame, estimate, blurred, self._known_score(frame, belief, estimate))

    def _known_score(self, frame: Frame, belief: Belief, estimate: MotionEstimate) -> float | None:
        """The last look's score, if nothing speaks against the box: every frame need not be one.

        While the track coasts, looks count only where the tracker is sure: until then they are not
        compared at all.
        """
        if belief.state is not TrackState.TRACKING and not self.doubting:
            return 0.0
        plain = belief.state is TrackState.TRACKING and not self._low
        sure = plain and self._confidence.relative(estimate.confidence) >= SURE
        return self._looks.recent(estimate.box, frame.captured_s) if sure else None

    def _judged(
        self, frame: Frame, estimate: MotionEstimate, blurred: bool, known: float | None = None
    ) -> Evidence:
        relative = self._confidence.relative(estimate.confidence)
        if not self._settings.appearance_check:
            return Evidence(estimate.box, estimate.confidence, relative, 2.0, 1.0)
        score = self._looks.score(frame.image, estimate.box) if known is None else known
        looks, fresh = self._looks.relative(score), known is None
        return Evidence(estimate.box, estimate.confidence, relative, score, looks, blurred, fresh)

    def _see(self, frame: Frame, belief: Belief, evidence: Evidence, interval_s: float) -> None:
        self._low, self._doubted_s, self._steady_s = 0, None, 0.0
        self._broken = False
        box = clamped(evidence.box, belief, self._settings)
        belief.see(box, evidence.relative, self._name)
        belief.kinematics.see(box)
        sure = evidence.fresh and evidence.relative >= SURE
        if sure and evidence.looks >= _NOTICED_LOOKS:
            self._looks.notice(evidence.score, evidence.box, frame.captured_s)
        if sure and evidence.looks >= _ANCHOR_LOOKS:
            belief.anchor()
            if not evidence.blurred:
                self._looks.learn(frame, box, evidence.score)
        self._confidence.learn(evidence.confidence, interval_s)
        if self._settings.appearance_check:
            self._looks.get_used(evidence.score, interval_s)
        belief.reference = drawn(belief.reference, box, interval_s)


def _left(belief: Belief, evidence: Evidence) -> bool:
    """Whether the tracker has gone where the target cannot be, or jumped where it hardly is."""
    jumped = evidence.box.distance(belief.carried_on()) > _LEAP_SIZES * evidence.box.scale
    if jumped and not belief.is_likely(evidence.box):
        return True
    return not belief.is_possible(evidence.box)


def _breaks(frame: Frame, belief: Belief, evidence: Evidence) -> bool:
    """Whether the tracker hesitated or jumped, so that this may be another thing than before.

    At the image's edge, where the target may have left, a smaller jump counts.
    """
    whole = belief.box.visible_share(frame.width, frame.height) >= _WHOLE
    reach = _JUMP_SIZES if whole else _JUMP_SIZES_EDGE
    jumped = evidence.box.distance(belief.carried_on()) > reach * evidence.box.scale
    return jumped or evidence.relative < _HESITANT
