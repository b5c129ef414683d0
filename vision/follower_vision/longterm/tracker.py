"""Follows one target through occlusion and absence without an object detector.

The "unfamiliar target" of Panda and Barczyk, "Blending of Learning-based Tracking and Object
Detection for Monocular Camera-based Target Following" (IFAC 2019), with their re-identification.
A motion tracker follows the box; it is believed only while its confidence, the box and what the
box shows make sense. Otherwise the track coasts briefly and then is lost, and the target is
searched for and recognised by its appearance.
"""

import math
from collections import deque
from dataclasses import replace

import numpy as np

from follower_vision.appearance.blur import BlurDetector
from follower_vision.appearance.frame_check import FrameCheck, FrameHealth
from follower_vision.appearance.reidentify import Reidentifier
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame
from follower_vision.longterm.box_check import (
    AcceptanceThreshold,
    BackgroundSimilarity,
    BoxAppearance,
    BoxCheck,
    BoxChecker,
    LongTermSettings,
    refined,
)
from follower_vision.longterm.search import TargetSearch
from follower_vision.trackers.motion_tracker import MotionEstimate, MotionTracker
from follower_vision.trackers.track import Track, TrackState

__all__ = ["LongTermSettings", "LongTermTracker"]

_MEMORY_S = 0.4
_LEAST_SPAN_S = 0.06
_FADE_S = 0.5
_SLACK = 0.05
_NEARNESS_FADES_S = 1.0
_FAR = 4.0
_SETTLING_S = 0.6
_RIVAL_REACH = 8.0
_OTHER_IOU = 0.2
_BETTER_SCORE = 0.15
_BETTER_FIT = 0.1


class Extrapolation:
    """Extrapolates a box by its velocity in the image over the last 0.4 s; the size stays.

    The velocity fades (time constant 0.5 s), because a guess gets worse with time and a drone
    that has stopped seeing its target stops turning with it.
    """

    def __init__(self) -> None:
        self._seen: deque[tuple[float, Box]] = deque()

    def reset(self) -> None:
        """Forget what was seen."""
        self._seen.clear()

    def add(self, captured_s: float, box: Box) -> None:
        """Remember a box that was really seen, at a time later than the last one's."""
        self._seen.append((captured_s, box))
        while self._seen[0][0] < captured_s - _MEMORY_S:
            self._seen.popleft()

    @property
    def last(self) -> tuple[float, Box]:
        """When the target was last seen, and where.

        Raises:
            RuntimeError: it was never seen.
        """
        if not self._seen:
            raise RuntimeError("no box was seen yet")
        return self._seen[-1]

    def predict(self, time_s: float) -> Box:
        """Return the box expected at `time_s`."""
        last_s, box = self.last
        right, down = self._velocity()
        reach_s = _FADE_S * (1 - math.exp(-max(0.0, time_s - last_s) / _FADE_S))
        return box.moved_to(box.cx + right * reach_s, box.cy + down * reach_s)

    def _velocity(self) -> tuple[float, float]:
        """Least-squares velocity in pixels a second; none while the memory is too short."""
        times = np.array([time_s for time_s, _ in self._seen])
        if times[-1] - times[0] < _LEAST_SPAN_S:
            return 0.0, 0.0
        centred = times - times.mean()
        places = np.array([(box.cx, box.cy) for _, box in self._seen])
        slope = centred @ places / (centred @ centred)
        return float(slope[0]), float(slope[1])


class LongTermTracker:
    """A motion tracker with track states and re-identification; see `TargetTracker`.

    `produced_by` is the motion tracker's name, "reacquired", or why the target was not seen:
    "coasting", "frozen", "blank", "lost". What a frame teaches is learnt after it is answered; see
    `Learner`.
    """

    def __init__(self, motion: MotionTracker, settings: LongTermSettings | None = None) -> None:
        self._settings = settings or LongTermSettings()
        self._motion = motion
        self._judge = BoxChecker(self._settings)
        self._reidentifier = Reidentifier(self._settings.reidentify)
        self._check = FrameCheck(self._settings.frame_check)
        self._blur = BlurDetector(self._settings.blur)
        self._acceptance = AcceptanceThreshold(self._settings)
        self._search = TargetSearch()
        self._surroundings = BackgroundSimilarity(self._reidentifier, self._search)
        self._coasting = Extrapolation()
        self._state = TrackState.LOST
        self._probation_ends_s: float | None = None
        self._settles_s: float | None = None
        self._refreshed_s = -math.inf
        self._score = 0.0
        self._compared_s = -math.inf
        self._started = False
        self._lesson: tuple[Frame, BoxCheck] | None = None

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
        self._compared_s = -math.inf
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
        check = self._checked(frame)
        rival = self._rival(frame, check)
        if rival is not None:
            return rival
        if self._probation_ends_s is not None:
            return self._probed(frame, check, self._probation_ends_s)
        if check.seen:
            return self._seen(frame, check)
        return self._reacquired(frame) or self._unseen(frame, "coasting")

    def learn(self) -> None:
        """Learn what the last frame taught: see `Learner`."""
        if self._lesson is None:
            return
        frame, check = self._lesson
        self._lesson = None
        self._surroundings.update(frame.image, check.box, frame.captured_s)
        self._keep(frame, check)

    def _checked(self, frame: Frame) -> BoxCheck:
        """Ask the motion tracker, and check its box."""
        estimate = self._motion.update(frame.image)
        strict = self._state is not TrackState.TRACKING
        appearance = self._appearance(frame, estimate, strict)
        return self._judge.judge(frame, estimate, appearance, self._coasting.last, strict)

    def _appearance(self, frame: Frame, estimate: MotionEstimate, strict: bool) -> BoxAppearance:
        """Compare what the box shows; comparing costs more than all else here."""
        blurred = self._blur.update(frame.image, estimate.box, frame.captured_s)
        sure = not strict and estimate.confidence >= self._settings.sure_confidence
        if not sure or frame.captured_s >= self._compared_s + self._settings.look_every_s:
            self._compared_s = frame.captured_s
            self._score = self._reidentifier.score(frame.image, estimate.box)
        return BoxAppearance(self._score, self._surroundings.level, blurred)

    def _probed(self, frame: Frame, check: BoxCheck, ends_s: float) -> Track:
        """Found, but only just: for `probation_s` it has to go on scoring as a found target."""
        if check.score < self._epsilon(frame.captured_s) - _SLACK:
            self._acceptance.fail(frame.captured_s)
            return self._lost(frame, "lost")
        if frame.captured_s >= ends_s:
            return self._seen(frame, check)
        self._coasting.add(frame.captured_s, check.box)
        return self._track(frame, check.box, check.confidence, "reacquired")

    def _seen(self, frame: Frame, check: BoxCheck) -> Track:
        self._state = TrackState.TRACKING
        self._probation_ends_s = None
        if check.believed:
            check = self._settled(frame, check)
            self._coasting.add(frame.captured_s, check.box)
            self._lesson = frame, check
        return self._track(frame, check.box, check.confidence, self._motion.name)

    def _settled(self, frame: Frame, check: BoxCheck) -> BoxCheck:
        """Shortly after a find, fit the box once more: it may have been found half in view."""
        if self._settles_s is None or frame.captured_s < self._settles_s:
            return check
        self._settles_s = None
        box, fit = self._refined(frame, check.box)
        if fit < self._reidentifier.fit(frame.image, check.box) + _BETTER_FIT:
            return check
        self._motion.start(frame.image, box)
        self._coasting.reset()
        return replace(check, box=box)

    def _rival(self, frame: Frame, check: BoxCheck) -> Track | None:
        """While a find is young, change over to a clearly better match nearby."""
        if self._settles_s is None:
            return None
        near = self._search.near(frame.image, check.box, _RIVAL_REACH * check.box.scale)
        found = self._reidentifier.best(
            frame.image, [box for box in near if box.iou(check.box) < _OTHER_IOU]
        )
        if found is None or found[1] < check.score + _BETTER_SCORE:
            return None
        return self._take(frame, *found, sure=False)

    def _refined(self, frame: Frame, box: Box) -> tuple[Box, float]:
        return refined(box, lambda near: self._reidentifier.fit(frame.image, near))

    def _keep(self, frame: Frame, check: BoxCheck) -> None:
        """Keep good views: the first second's for good, later ones for a while."""
        if not check.good_view or self._settles_s is not None:
            return
        self._reidentifier.learn(frame.image, check.box, frame.captured_s)
        if frame.captured_s >= self._refreshed_s + self._settings.refresh_s:
            self._refreshed_s = frame.captured_s
            self._reidentifier.refresh(frame.image, check.box)
            self._search.learn(frame.image, check.box)

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
        away_s = max(0.0, frame.captured_s - self._coasting.last[0])
        expected = self._coasting.predict(frame.captured_s)
        reach = expected.scale * (settings.reach + settings.reach_growth_s * away_s)
        if self._state is TrackState.LOST:
            return self._search.everywhere(frame.image, expected, reach)
        return self._search.near(frame.image, expected, reach)

    def _best(self, frame: Frame, candidates: list[Box]) -> tuple[Box, float] | None:
        """The most likely candidate by appearance and, soon after the loss, by position."""
        expected = self._coasting.predict(frame.captured_s)
        away_s = max(0.0, frame.captured_s - self._coasting.last[0])
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
