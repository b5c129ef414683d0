"""Follows one target through occlusion and absence without an object detector.

The "unfamiliar target" of Panda and Barczyk, "Blending of Learning-based Tracking and Object
Detection for Monocular Camera-based Target Following" (IFAC 2019), with their re-identification.
A motion tracker follows the box; it is believed only while its confidence, the box and what the
box shows make sense. Otherwise the track coasts for a moment and then is lost, and the target is
searched for and recognised by its looks.
"""

from __future__ import annotations

import math
from dataclasses import replace

from follower_vision.acceptance import Acceptance
from follower_vision.blur import BlurDetector
from follower_vision.box import Box
from follower_vision.coasting import Coasting
from follower_vision.frame import Frame
from follower_vision.framecheck import FrameCheck, FrameHealth
from follower_vision.longterm_settings import LongTermSettings
from follower_vision.motion import MotionEstimate, MotionTracker
from follower_vision.refine import refined
from follower_vision.reidentify import Reidentifier
from follower_vision.sighting import Looks, Sighting, SightingJudge
from follower_vision.surroundings import Surroundings
from follower_vision.targetsearch import TargetSearch
from follower_vision.track import Track, TrackState

__all__ = ["LongTermSettings", "LongTermTracker"]

_SLACK = 0.05
_NEARNESS_FADES_S = 1.0
_FAR = 4.0
_SETTLING_S = 0.6
_RIVAL_REACH = 8.0
_OTHER_IOU = 0.2
_BETTER_SCORE = 0.15
_BETTER_FIT = 0.1


class LongTermTracker:
    """A motion tracker with honest states and re-identification; see `TargetTracker`.

    `produced_by` is the motion tracker's name, "reacquired", or why the target was not seen:
    "coasting", "frozen", "blank", "lost". What a frame teaches is learnt after it is answered; see
    `Learner`.
    """

    def __init__(self, motion: MotionTracker, settings: LongTermSettings | None = None) -> None:
        self._settings = settings or LongTermSettings()
        self._motion = motion
        self._judge = SightingJudge(self._settings)
        self._reidentifier = Reidentifier(self._settings.reidentify)
        self._check = FrameCheck(self._settings.frame_check)
        self._blur = BlurDetector(self._settings.blur)
        self._acceptance = Acceptance(self._settings)
        self._search = TargetSearch()
        self._surroundings = Surroundings(self._reidentifier, self._search)
        self._coasting = Coasting()
        self._state = TrackState.LOST
        self._probation_ends_s: float | None = None
        self._settles_s: float | None = None
        self._refreshed_s = -math.inf
        self._score = 0.0
        self._looked_s = -math.inf
        self._started = False
        self._lesson: tuple[Frame, Sighting] | None = None

    def start(self, frame: Frame, box: Box) -> Track:
        """Choose the target: what `box` shows in `frame`. Everything earlier is forgotten.

        Raises:
            ValueError: less than a tenth of the box lies inside the image.
        """
        if box.visible_share(frame.width, frame.height) < 0.1:
            raise ValueError(
                f"the target's box (x {box.left:.0f}, y {box.top:.0f}, {box.width:.0f} x "
                f"{box.height:.0f}) lies outside the image of {frame.width} x {frame.height}"
            )
        self._lesson = None
        self._check = FrameCheck(self._settings.frame_check)
        self._check.update(frame)
        self._blur.reset()
        self._judge.reset()
        self._surroundings.reset()
        self._acceptance.reset()
        self._reidentifier.start(frame.image, box, frame.captured_s)
        self._search.learn(frame.image, box)
        self._settles_s = None
        self._looked_s = -math.inf
        self._started, self._refreshed_s = True, frame.captured_s
        return self._restart(frame, box, 1.0, TrackState.TRACKING, self._motion.name)

    def step(self, frame: Frame) -> Track:
        """Return the target's track in the next frame.

        Raises:
            RuntimeError: `start` was not called.
        """
        if not self._started:
            raise RuntimeError("the tracker was not started")
        self.learn()
        health = self._check.update(frame)
        if health is not FrameHealth.GOOD:
            return self._unseen(frame, health.value)
        if self._state is TrackState.LOST:
            return self._reacquired(frame) or self._unseen(frame, "lost")
        sighting = self._sighting(frame)
        rival = self._rival(frame, sighting)
        if rival is not None:
            return rival
        if self._probation_ends_s is not None:
            return self._probed(frame, sighting, self._probation_ends_s)
        if sighting.seen:
            return self._seen(frame, sighting)
        return self._reacquired(frame) or self._unseen(frame, "coasting")

    def learn(self) -> None:
        """Learn what the last frame taught: see `Learner`."""
        if self._lesson is None:
            return
        frame, sighting = self._lesson
        self._lesson = None
        self._surroundings.update(frame.image, sighting.box, frame.captured_s)
        self._keep(frame, sighting)

    def _sighting(self, frame: Frame) -> Sighting:
        """Ask the motion tracker, and judge what it says."""
        estimate = self._motion.update(frame.image)
        strict = self._state is not TrackState.TRACKING
        looks = self._look(frame, estimate, strict)
        return self._judge.judge(frame, estimate, looks, self._coasting.last, strict)

    def _look(self, frame: Frame, estimate: MotionEstimate, strict: bool) -> Looks:
        """Compare what the box shows; comparing costs more than all else here."""
        blurred = self._blur.update(frame.image, estimate.box, frame.captured_s).blurred
        sure = not strict and estimate.confidence >= self._settings.sure_confidence
        if not sure or frame.captured_s >= self._looked_s + self._settings.look_every_s:
            self._looked_s = frame.captured_s
            self._score = self._reidentifier.score(frame.image, estimate.box)
        return Looks(self._score, self._surroundings.level, blurred)

    def _probed(self, frame: Frame, sighting: Sighting, ends_s: float) -> Track:
        """Found, but only just: it has to go on scoring as a found target for a moment."""
        if sighting.score < self._epsilon(frame.captured_s) - _SLACK:
            self._acceptance.fail(frame.captured_s)
            return self._lost(frame, "lost")
        if frame.captured_s >= ends_s:
            return self._seen(frame, sighting)
        self._coasting.add(frame.captured_s, sighting.box)
        return self._track(frame, sighting.box, sighting.confidence, "reacquired")

    def _seen(self, frame: Frame, sighting: Sighting) -> Track:
        self._state = TrackState.TRACKING
        self._probation_ends_s = None
        if sighting.believed:
            sighting = self._settled(frame, sighting)
            self._coasting.add(frame.captured_s, sighting.box)
            self._lesson = frame, sighting
        return self._track(frame, sighting.box, sighting.confidence, self._motion.name)

    def _settled(self, frame: Frame, sighting: Sighting) -> Sighting:
        """A moment after a find, fit the box once more: it may have been found half in view."""
        if self._settles_s is None or frame.captured_s < self._settles_s:
            return sighting
        self._settles_s = None
        box, fit = self._refined(frame, sighting.box)
        if fit < self._reidentifier.fit(frame.image, sighting.box) + _BETTER_FIT:
            return sighting
        self._motion.start(frame.image, box)
        self._coasting.reset()
        return replace(sighting, box=box)

    def _rival(self, frame: Frame, sighting: Sighting) -> Track | None:
        """While a find is young, change over to what looks clearly more like the target nearby."""
        if self._settles_s is None:
            return None
        near = self._search.near(frame.image, sighting.box, _RIVAL_REACH * sighting.box.scale)
        found = self._reidentifier.best(
            frame.image, [box for box in near if box.iou(sighting.box) < _OTHER_IOU]
        )
        if found is None or found[1] < sighting.score + _BETTER_SCORE:
            return None
        return self._take(frame, *found, sure=False)

    def _refined(self, frame: Frame, box: Box) -> tuple[Box, float]:
        return refined(box, lambda near: self._reidentifier.fit(frame.image, near))

    def _keep(self, frame: Frame, sighting: Sighting) -> None:
        """Keep good views: the first second's for good, later ones for a while."""
        if not sighting.good_view or self._settles_s is not None:
            return
        self._reidentifier.learn(frame.image, sighting.box, frame.captured_s)
        if frame.captured_s >= self._refreshed_s + self._settings.refresh_s:
            self._refreshed_s = frame.captured_s
            self._reidentifier.refresh(frame.image, sighting.box)
            self._search.learn(frame.image, sighting.box)

    def _unseen(self, frame: Frame, why: str) -> Track:
        """Coast for a while; then, or where the target has left the image, it is lost."""
        last_s, _ = self._coasting.last
        expected = self._coasting.predict(frame.captured_s)
        gone = expected.visible_share(frame.width, frame.height) < self._settings.least_visible
        late = frame.captured_s - last_s > self._settings.coast_s
        on_probation = self._probation_ends_s is not None
        if self._state is TrackState.LOST or on_probation or gone or late:
            return self._lost(frame, "lost" if why == "coasting" else why)
        self._state = TrackState.COASTING
        return self._track(frame, expected, 0.0, why)

    def _lost(self, frame: Frame, why: str) -> Track:
        self._state = TrackState.LOST
        self._probation_ends_s = None
        return self._track(frame, self._coasting.last[1], 0.0, why)

    def _reacquired(self, frame: Frame) -> Track | None:
        """Search; a candidate that is recognised becomes the track, on probation if only just."""
        found = self._best(frame, self._candidates(frame))
        epsilon = self._epsilon(frame.captured_s)
        if found is None or found[1] < epsilon:
            return None
        sure = found[1] >= epsilon + self._settings.sure_margin
        return self._take(frame, *found, sure=sure)

    def _take(self, frame: Frame, place: Box, score: float, sure: bool) -> Track:
        """Go on from a found box."""
        box, _ = self._refined(frame, place)
        self._settles_s = frame.captured_s + _SETTLING_S
        state = TrackState.TRACKING if sure else TrackState.COASTING
        return self._restart(frame, box, min(1.0, score / 2), state, "reacquired")

    def _candidates(self, frame: Frame) -> list[Box]:
        """Where the target might be by now: near while it coasts, anywhere once it is lost."""
        settings = self._settings
        away_s = frame.captured_s - self._coasting.last[0]
        expected = self._coasting.predict(frame.captured_s)
        reach = expected.scale * (settings.reach + settings.reach_growth_s * away_s)
        if self._state is TrackState.LOST:
            return self._search.everywhere(frame.image, expected, reach)
        return self._search.near(frame.image, expected, reach)

    def _best(self, frame: Frame, candidates: list[Box]) -> tuple[Box, float] | None:
        """The likeliest candidate by its looks and, soon after the loss, its place."""
        expected = self._coasting.predict(frame.captured_s)
        away_s = frame.captured_s - self._coasting.last[0]
        weight = self._settings.nearness * math.exp(-away_s / _NEARNESS_FADES_S)
        scored = [
            (
                box,
                self._reidentifier.score(frame.image, box)
                - weight * min(1.0, box.distance(expected) / (_FAR * expected.scale)),
            )
            for box in candidates
        ]
        return max(scored, key=lambda pair: pair[1], default=None)

    def _epsilon(self, now_s: float) -> float:
        return self._acceptance.epsilon(self._surroundings.level, now_s)

    def _restart(
        self, frame: Frame, box: Box, confidence: float, state: TrackState, produced_by: str
    ) -> Track:
        """Set the motion tracker onto a box and take its past as unknown."""
        self._motion.start(frame.image, box)
        self._judge.restart()
        self._coasting.reset()
        self._coasting.add(frame.captured_s, box)
        self._state = state
        certain = state is TrackState.TRACKING
        probation_ends_s = frame.captured_s + self._settings.probation_s
        self._probation_ends_s = None if certain else probation_ends_s
        return self._track(frame, box, confidence, produced_by)

    def _track(self, frame: Frame, box: Box, confidence: float, produced_by: str) -> Track:
        return Track(box, self._state, confidence, produced_by, frame.captured_s, frame.sequence)
