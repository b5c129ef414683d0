"""Follows the target from frame to frame by a motion tracker, as far as it can be believed."""

from __future__ import annotations

import math
from typing import Protocol, runtime_checkable

from follower_vision.box import Box
from follower_vision.frame import Frame
from follower_vision.fusion.belief import Belief, towards
from follower_vision.fusion.looks import Looks
from follower_vision.fusion.settings import FusionSettings
from follower_vision.fusion.trust import Trust
from follower_vision.motion import MotionEstimate, MotionTracker
from follower_vision.track import TrackState

_LEAST_VISIBLE = 0.3
_SURE = 0.95
_RESUME_SIZES = 1.5
_RESUME_SIZES_S = 4.0
_RESUME_MARGIN = 0.1
_REFERENCE_MEMORY_S = 0.7


@runtime_checkable
class SteerableTracker(MotionTracker, Protocol):
    """A motion tracker that can be sent elsewhere without forgetting what it looks for."""

    def move_to(self, box: Box) -> None:
        """Search about `box` next time."""
        ...


class Following:
    """Runs the motion tracker, and coasts when it is unsure."""

    def __init__(self, motion: MotionTracker, settings: FusionSettings, looks: Looks) -> None:
        self._motion = motion
        self._settings = settings
        self._looks = looks
        self._trust = Trust()
        self._low = 0

    def start(self, frame: Frame, box: Box) -> None:
        """Follow another target."""
        self._motion.start(frame.image, box)
        self._trust = Trust()
        self._low = 0

    def relocate(self, frame: Frame, box: Box) -> None:
        """Go on from another place; in the paper's way, learning anew what is there."""
        self._low = 0
        if isinstance(self._motion, SteerableTracker) and self._settings.keep_template:
            self._motion.move_to(box)
        else:
            self._motion.start(frame.image, box)

    def follow(self, frame: Frame, belief: Belief, expected: Box, interval_s: float) -> None:
        """Find the target in the next frame and write down what to believe.

        Args:
            frame: the next frame.
            belief: already brought to this frame by the camera's motion.
            expected: where the target should be.
            interval_s: since the last frame.
        """
        if isinstance(self._motion, SteerableTracker):
            self._motion.move_to(belief.box if self._low == 1 else expected)
        estimate = self._motion.update(frame.image)
        relative = self._trust.relative(estimate.confidence)
        belief.confidence = relative
        if self._believable(frame, belief, estimate, expected, relative):
            self._low = 0
            self._trust.learn(estimate.confidence, interval_s)
            self._see(frame, belief, estimate, interval_s)
            return
        self._low += 1
        if self._low < self._settings.low_frames and belief.state is TrackState.TRACKING:
            belief.box = self._clamped(estimate.box, belief.reference)
        else:
            self.coast(frame, belief, expected, "coasting")

    def coast(self, frame: Frame, belief: Belief, expected: Box, why: str) -> None:
        """The target is not seen: extrapolate for a while, then it is lost."""
        belief.box = expected
        gone = expected.visible_share(frame.width, frame.height) < _LEAST_VISIBLE
        late = belief.unseen_s > self._settings.coast_s
        if belief.state is TrackState.LOST or gone or late:
            belief.state = TrackState.LOST
            belief.produced_by = "lost" if why == "coasting" else why
        else:
            belief.state = TrackState.COASTING
            belief.produced_by = why

    def _believable(
        self, frame: Frame, belief: Belief, estimate: MotionEstimate, expected: Box, relative: float
    ) -> bool:
        settings = self._settings
        if not settings.score_coasting:
            return belief.state is TrackState.TRACKING
        if belief.state is TrackState.TRACKING:
            return relative >= settings.low_ratio
        if relative < settings.resume_ratio:
            return False
        away = expected.distance(estimate.box) / expected.scale
        if away > _RESUME_SIZES + _RESUME_SIZES_S * belief.unseen_s:
            return False
        return belief.state is not TrackState.LOST or self._recognised(frame, estimate.box)

    def _recognised(self, frame: Frame, box: Box) -> bool:
        return self._looks.score(frame.image, box) >= self._looks.epsilon - _RESUME_MARGIN

    def _see(
        self, frame: Frame, belief: Belief, estimate: MotionEstimate, interval_s: float
    ) -> None:
        box = self._clamped(estimate.box, belief.reference)
        belief.see(box, belief.confidence, self._motion.name)
        belief.kinematics.see(box)
        if belief.unconfirmed_s > _REFERENCE_MEMORY_S:
            share = 1 - math.exp(-interval_s / _REFERENCE_MEMORY_S)
            belief.reference = towards(belief.reference, box, share)
        self._looks.learn(frame, box, belief.confidence >= _SURE)

    def _clamped(self, box: Box, reference: Box) -> Box:
        """Keep the size near the reference's."""
        settings = self._settings
        if not settings.size_clamp:
            return box
        least, most = reference.scaled(settings.size_least), reference.scaled(settings.size_most)
        width = min(max(box.width, least.width), most.width)
        return Box(box.cx, box.cy, width, min(max(box.height, least.height), most.height))
