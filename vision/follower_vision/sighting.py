"""Judges whether a motion tracker's box really shows the target."""

from __future__ import annotations

import math
from dataclasses import dataclass

from follower_vision.box import Box
from follower_vision.frame import Frame
from follower_vision.longterm_settings import LongTermSettings
from follower_vision.motion import MotionEstimate

_USUAL_MEMORY_S = 2.0


@dataclass(frozen=True, slots=True)
class Looks:
    """What a box shows.

    Attributes:
        score: its re-identification score, 0 to 2.
        surroundings: the highest score around the target of late; None if unknown.
        blurred: whether its neighbourhood is blurred.
    """

    score: float
    surroundings: float | None
    blurred: bool


@dataclass(frozen=True, slots=True)
class Sighting:
    """A motion tracker's box, judged.

    Attributes:
        box: in pixels.
        confidence: 0 to 1, the least of what the judgements say.
        seen: whether the target is to be taken as seen in this frame, if only for patience.
        believed: whether it is so without any doubt.
        good_view: whether the box is fit to be learnt from.
        score: the box's re-identification score, 0 to 2.
    """

    box: Box
    confidence: float
    seen: bool
    believed: bool
    good_view: bool
    score: float


class SightingJudge:
    """Weighs confidence, appearance and plausibility, with hysteresis and a moment's patience.

    Confidences of different motion trackers do not compare, nor do scores of different targets;
    so each is measured against its own usual value.
    """

    def __init__(self, settings: LongTermSettings) -> None:
        self._settings = settings
        self._usual_confidence: float | None = None
        self._usual_score: float | None = None
        self._judged_s = 0.0
        self._doubt_since_s: float | None = None

    def reset(self) -> None:
        """Forget everything: another target."""
        self._usual_confidence = self._usual_score = None
        self.restart()

    def restart(self) -> None:
        """The motion tracker was set anew; what is usual for it stays known."""
        self._doubt_since_s = None

    def judge(
        self,
        frame: Frame,
        estimate: MotionEstimate,
        looks: Looks,
        last: tuple[float, Box],
        strict: bool,
    ) -> Sighting:
        """Judge an estimate.

        Args:
            frame: the frame that it is for.
            estimate: what the motion tracker says.
            looks: what the box shows.
            last: when and where the target was last seen.
            strict: whether it has to convince anew, because it was not seen just before.
        """
        settings = self._settings
        relative = _share(estimate.confidence, self._usual_confidence)
        plausible = self._plausible(frame, estimate.box, last)
        believed = plausible and self._convinces(relative, looks, strict)
        patient = not strict and self._patient(relative, frame.captured_s, believed)
        if believed:
            self._adapt(estimate.confidence, looks.score, frame.captured_s - self._judged_s)
        self._judged_s = frame.captured_s
        fit = relative >= settings.high_ratio and looks.score >= settings.reidentify.epsilon
        return Sighting(
            estimate.box,
            min(relative, max(0.0, looks.score / settings.reidentify.epsilon), 1.0) * plausible,
            seen=plausible and (believed or patient),
            believed=believed,
            good_view=believed and fit and not looks.blurred,
            score=looks.score,
        )

    def _convinces(self, relative: float, looks: Looks, strict: bool) -> bool:
        """Weigh confidence and appearance; more is asked where `strict`."""
        settings = self._settings
        least = self._least_score(looks.surroundings)
        if strict:
            return relative >= settings.high_ratio and looks.score >= least + settings.resume_margin
        return relative >= settings.low_ratio and looks.score >= least

    def _least_score(self, surroundings: float | None) -> float:
        settings = self._settings
        enough = settings.recognised_score
        if surroundings is not None:
            enough = min(enough, surroundings + settings.surroundings_margin)
        if self._usual_score is not None:
            enough = max(enough, self._usual_score - settings.score_drop)
        return max(enough, settings.reject_score)

    def _patient(self, relative: float, now_s: float, believed: bool) -> bool:
        """Whether doubt is too young to speak of."""
        if believed:
            self._doubt_since_s = None
            return True
        if self._doubt_since_s is None:
            self._doubt_since_s = now_s
        settings = self._settings
        confident = relative >= settings.high_ratio
        patience_s = settings.looks_doubt_s if confident else settings.doubt_s
        return now_s - self._doubt_since_s < patience_s

    def _plausible(self, frame: Frame, box: Box, last: tuple[float, Box]) -> bool:
        settings = self._settings
        last_s, before = last
        allowed = settings.size_jump + settings.size_rate_s * (frame.captured_s - last_s)
        if abs(math.log(box.scale / before.scale)) > allowed:
            return False
        return box.visible_share(frame.width, frame.height) >= settings.least_visible

    def _adapt(self, confidence: float, score: float, interval_s: float) -> None:
        share = 1 - math.exp(-max(0.0, interval_s) / _USUAL_MEMORY_S)
        self._usual_confidence = _towards(self._usual_confidence, confidence, share)
        self._usual_score = _towards(self._usual_score, score, share)


def _towards(usual: float | None, value: float, share: float) -> float:
    return value if usual is None else usual + share * (value - usual)


def _share(value: float, usual: float | None) -> float:
    """Value as a share of what is usual, at most 1; a first value is usual."""
    if usual is None:
        return 1.0 if value > 0 else 0.0
    return min(1.0, value / usual) if usual > 0 else 0.0
