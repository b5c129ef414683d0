"""Judges whether a motion tracker's box really shows the target."""

from __future__ import annotations

import math
from dataclasses import dataclass

from follower_vision.box import Box
from follower_vision.frame import Frame
from follower_vision.longterm_settings import LongTermSettings
from follower_vision.motion import MotionEstimate

_USUAL_MEMORY_S = 2.0
_SCORE_MEMORY_S = 0.08


@dataclass(frozen=True, slots=True)
class Sighting:
    """A motion tracker's box, judged.

    Attributes:
        box: in pixels.
        confidence: 0 to 1, the least of what the judgements say.
        seen: whether the target is to be taken as seen in this frame.
        good_view: whether the box is fit to be learnt from.
        score: the box's own re-identification score, 0 to 2; None if blurred.
    """

    box: Box
    confidence: float
    seen: bool
    good_view: bool
    score: float | None


@dataclass(frozen=True, slots=True)
class Looks:
    """What a box shows.

    Attributes:
        score: its re-identification score, 0 to 2; None where blur forbids one.
        surroundings: the highest score around the target of late; None if unknown.
    """

    score: float | None
    surroundings: float | None


class SightingJudge:
    """Weighs confidence, appearance and plausibility, with hysteresis and a moment's patience.

    Confidences of different motion trackers do not compare; so each is measured against its own
    usual value.
    """

    def __init__(self, settings: LongTermSettings) -> None:
        self._settings = settings
        self._usual: float | None = None
        self._score: float | None = None
        self._judged_s = 0.0
        self._doubt_since_s: float | None = None

    def reset(self) -> None:
        """Forget everything: another target."""
        self._usual = None
        self.restart()

    def restart(self) -> None:
        """The motion tracker was set anew; what is usual for it stays known."""
        self._score = None
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
        usual = estimate.confidence if self._usual is None else self._usual
        relative = min(1.0, estimate.confidence / usual) if usual > 0 else 0.0
        smooth = self._smoothed(looks.score, frame.captured_s)
        plausible = self._plausible(frame, estimate.box, last)
        believed = plausible and self._convinces(relative, smooth, looks.surroundings, strict)
        seen = plausible and (
            believed or (not strict and self._patient(relative, frame.captured_s))
        )
        if believed:
            self._doubt_since_s = None
            self._adapt_usual(estimate.confidence, frame.captured_s - self._judged_s)
        self._judged_s = frame.captured_s
        epsilon = self._settings.reidentify.epsilon
        confidence = min(relative, max(0.0, smooth / epsilon), 1.0) if plausible else 0.0
        good = believed and relative >= self._settings.high_ratio and smooth >= epsilon
        learn = good and looks.score is not None
        return Sighting(estimate.box, confidence, seen, learn, looks.score)

    def _smoothed(self, score: float | None, now_s: float) -> float:
        if score is None:
            return self._settings.recognised_score if self._score is None else self._score
        if self._score is None:
            self._score = score
        share = 1 - math.exp(-max(0.0, now_s - self._judged_s) / _SCORE_MEMORY_S)
        self._score += share * (score - self._score)
        return self._score

    def _convinces(
        self, relative: float, score: float, surroundings: float | None, strict: bool
    ) -> bool:
        """Weigh confidence and appearance; more is asked where `strict`."""
        settings = self._settings
        more = settings.resume_margin if strict else 0.0
        enough = settings.recognised_score
        if surroundings is not None:
            enough = min(enough, surroundings + settings.surroundings_margin)
        least = max(enough + more, settings.reject_score)
        return score >= least and relative >= (
            settings.high_ratio if strict else settings.low_ratio
        )

    def _patient(self, relative: float, now_s: float) -> bool:
        """Whether doubt is too young to speak of."""
        settings = self._settings
        confident = relative >= settings.high_ratio
        patience_s = settings.looks_doubt_s if confident else settings.doubt_s
        if self._doubt_since_s is None:
            self._doubt_since_s = now_s
        return now_s - self._doubt_since_s < patience_s

    def _plausible(self, frame: Frame, box: Box, last: tuple[float, Box]) -> bool:
        settings = self._settings
        last_s, before = last
        allowed = settings.size_jump + settings.size_rate_s * (frame.captured_s - last_s)
        if abs(math.log(box.scale / before.scale)) > allowed:
            return False
        return box.visible_share(frame.width, frame.height) >= settings.least_visible

    def _adapt_usual(self, confidence: float, interval_s: float) -> None:
        if self._usual is None:
            self._usual = confidence
        share = 1 - math.exp(-max(0.0, interval_s) / _USUAL_MEMORY_S)
        self._usual += share * (confidence - self._usual)
