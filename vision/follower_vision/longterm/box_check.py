"""Judges whether a motion tracker's box really shows the target."""

import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from follower_vision.appearance.blur import BlurSettings
from follower_vision.appearance.frame_check import FrameCheckSettings
from follower_vision.appearance.reidentify import Reidentifier, ReidentifySettings
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Frame, Image
from follower_vision.longterm.search import TargetSearch
from follower_vision.trackers.motion_tracker import MotionEstimate

_USUAL_MEMORY_S = 2.0
_STRIKE = 0.05
_FORGIVEN_PER_S = 1.0
_EVERY_S = 0.2
_MEMORY_S = 1.5
_ASIDE = ((2.0, 0.0), (-2.0, 0.0), (0.0, 2.0), (0.0, -2.0))
_DIAGONAL = ((1.4, 1.4), (-1.4, -1.4), (1.4, -1.4), (-1.4, 1.4))
_LEAST_VISIBLE = 0.9
_REACH = 8.0
_OTHER_IOU = 0.1
_STEPS = (0.2, 0.1)
_ROUNDS = 2


_NOT_NEGATIVE = (
    *("doubt_s", "looks_doubt_s", "look_every_s", "coast_s", "refresh_s", "probation_s"),
    *("reach", "reach_growth_s", "size_jump", "size_rate_s"),
)


@dataclass(frozen=True, slots=True)
class LongTermSettings:
    """When a track is believed, and what happens when it is not.

    Attributes:
        low_ratio: a motion tracker's confidence below this share of its usual one is doubt.
        high_ratio: it has to come back to this share to be believed again.
        recognised_score: a box with this re-identification score (0 to 2) shows the target.
        surroundings_margin: with less it has to exceed the score of its surroundings by this.
        score_drop: and it has to come within this of the target's usual score.
        reject_score: with less than this it is doubted in any case.
        resume_margin: how much better both have to be to be believed again.
        doubt_s: how long doubt may last before the track says so.
        looks_doubt_s: the same, where only the appearance is in doubt, not the confidence.
        look_every_s: while the motion tracker is sure, the appearance is compared this often.
        sure_confidence: from this confidence on it is sure.
        size_jump: largest change of the box's scale at once, as a natural logarithm.
        size_rate_s: how much more for each second since the target was last seen.
        least_visible: a box with less than this share inside the image is not seen.
        coast_s: how long a box is extrapolated before the target is lost.
        reach: side of the square searched around the expected place, in target sizes.
        reach_growth_s: how many target sizes it grows in a second.
        look_alike_margin: a found target has to exceed what its surroundings scored by this; see
            `most_epsilon`.
        most_epsilon: the surroundings do not raise the score asked of a found target above this.
        nearness: how much a find far from the expected place is marked down just after the loss;
            this fades within seconds, as the target may be anywhere by then.
        sure_margin: a found target that exceeds epsilon by less is on probation.
        probation_s: how long it then has to keep up its score.
        refresh_s: how often a recent view is kept.
    """

    low_ratio: float = 0.2
    high_ratio: float = 0.4
    recognised_score: float = 1.1
    surroundings_margin: float = 0.05
    score_drop: float = 0.8
    reject_score: float = 0.5
    resume_margin: float = 0.15
    doubt_s: float = 0.05
    looks_doubt_s: float = 0.25
    look_every_s: float = 0.08
    sure_confidence: float = 0.9
    size_jump: float = 0.4
    size_rate_s: float = 2.0
    least_visible: float = 0.3
    coast_s: float = 0.5
    reach: float = 4.0
    reach_growth_s: float = 8.0
    look_alike_margin: float = 0.1
    most_epsilon: float = 1.6
    nearness: float = 0.3
    sure_margin: float = 0.3
    probation_s: float = 0.15
    refresh_s: float = 0.5
    reidentify: ReidentifySettings = field(default_factory=ReidentifySettings)
    blur: BlurSettings = field(default_factory=BlurSettings)
    frame_check: FrameCheckSettings = field(default_factory=FrameCheckSettings)

    def __post_init__(self) -> None:
        if not 0 <= self.low_ratio <= self.high_ratio <= 1:
            raise ValueError("long-term tracker: 0 <= low_ratio <= high_ratio <= 1 has to hold")
        if not self.reject_score <= self.recognised_score <= 2:
            raise ValueError("long-term tracker: reject_score <= recognised_score <= 2 has to hold")
        if not 0 <= self.least_visible < 1:
            raise ValueError("long-term tracker: least_visible lies between 0 and 1")
        for name in _NOT_NEGATIVE:
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"long-term tracker: {name} has to be 0 or more")


@dataclass(frozen=True, slots=True)
class BoxAppearance:
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
class BoxCheck:
    """A motion tracker's box, judged.

    Attributes:
        box: in pixels.
        confidence: 0 to 1, the least of what the single judgements say.
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


class BoxChecker:
    """Weighs confidence, appearance and plausibility, with hysteresis and `doubt_s` of patience.

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
        appearance: BoxAppearance,
        last: tuple[float, Box],
        strict: bool,
    ) -> BoxCheck:
        """Judge an estimate.

        Args:
            frame: the frame that it is for.
            estimate: what the motion tracker says.
            appearance: what the box shows.
            last: when and where the target was last seen.
            strict: whether it has to convince anew, because it was not seen just before.
        """
        settings = self._settings
        relative = _share(estimate.confidence, self._usual_confidence)
        plausible = self._plausible(frame, estimate.box, last)
        believed = plausible and self._convinces(relative, appearance, strict)
        patient = not strict and self._patient(relative, frame.captured_s, believed)
        if believed:
            self._adapt(estimate.confidence, appearance.score, frame.captured_s - self._judged_s)
        self._judged_s = frame.captured_s
        epsilon = settings.reidentify.epsilon
        fit = relative >= settings.high_ratio and appearance.score >= epsilon
        return BoxCheck(
            estimate.box,
            min(relative, max(0.0, appearance.score / epsilon), 1.0) * plausible,
            seen=plausible and (believed or patient),
            believed=believed,
            good_view=believed and fit and not appearance.blurred,
            score=appearance.score,
        )

    def _convinces(self, relative: float, appearance: BoxAppearance, strict: bool) -> bool:
        """Weigh confidence and appearance; more is asked where `strict`."""
        settings = self._settings
        least = self._least_score(appearance.surroundings)
        if strict:
            needed = settings.high_ratio, least + settings.resume_margin
        else:
            needed = settings.low_ratio, least
        return relative >= needed[0] and appearance.score >= needed[1]

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


class AcceptanceThreshold:
    """The paper's epsilon, raised where it would be reached by chance.

    Among similar things a higher score is needed; and after each candidate that passed but
    did not prove true, because who draws often enough draws a wrong one that fits.
    """

    def __init__(self, settings: LongTermSettings) -> None:
        self._settings = settings
        self._strikes = 0.0
        self._struck_s = 0.0

    def reset(self) -> None:
        """Forget the failures: the target was found, or another one was chosen."""
        self._strikes = 0.0

    def fail(self, now_s: float) -> None:
        """A candidate that had passed was not the target after all."""
        self._strikes = self._left(now_s) + 1
        self._struck_s = now_s

    def epsilon(self, surroundings: float | None, now_s: float) -> float:
        """Return the least score, 0 to 2.

        Args:
            surroundings: the highest score of the target's surroundings; None if unknown.
            now_s: the frame's time in seconds.
        """
        settings = self._settings
        paper = settings.reidentify.epsilon
        among = (surroundings or 0.0) + settings.look_alike_margin
        asked = max(paper, among) + _STRIKE * self._left(now_s)
        return max(paper, min(asked, settings.most_epsilon))

    def _left(self, now_s: float) -> float:
        """The strikes that time has not forgiven yet."""
        return max(0.0, self._strikes - _FORGIVEN_PER_S * (now_s - self._struck_s))


class BackgroundSimilarity:
    """Scores what is not the target as if it were a candidate, now and then.

    In turn: boxes beside the target, boxes diagonally from it, and what the search would propose.
    A tracker that has slid onto the background has a box that scores like the background; and
    in a picture full of look-alikes a score has to be higher to mean anything.
    """

    def __init__(self, reidentifier: Reidentifier, search: TargetSearch) -> None:
        self._reidentifier = reidentifier
        self._search = search
        self._levels: deque[tuple[float, float]] = deque()
        self._turn = 0

    def reset(self) -> None:
        """Forget the levels: another target."""
        self._levels.clear()

    @property
    def level(self) -> float | None:
        """Highest re-identification score (0 to 2) around the target of late.

        None while nothing was measured. It keeps its last value while nothing new is measured.
        """
        return max((level for _, level in self._levels), default=None)

    def update(self, image: Image, box: Box, now_s: float) -> None:
        """Measure around the target's box if it is time to; call it when the target is seen."""
        if self._levels and now_s < self._levels[-1][0] + _EVERY_S:
            return
        self._turn += 1
        level = self._measured(image, box)
        if math.isfinite(level):
            self._levels.append((now_s, level))
        while self._levels and self._levels[0][0] < now_s - _MEMORY_S:
            self._levels.popleft()

    def _measured(self, image: Image, box: Box) -> float:
        """Highest score of a few boxes; minus infinity if there are none."""
        scores = (self._reidentifier.score(image, place) for place in self._places(image, box))
        return max(scores, default=-math.inf)

    def _places(self, image: Image, box: Box) -> list[Box]:
        height, width = image.shape[:2]
        turn = self._turn % 3
        if turn == 0:
            found = self._search.everywhere(image, box, _REACH * box.scale)
            return [place for place in found if place.iou(box) < _OTHER_IOU]
        shifts = _DIAGONAL if turn == 1 else _ASIDE
        places = [box.moved_to(box.cx + x * box.width, box.cy + y * box.height) for x, y in shifts]
        return [place for place in places if place.visible_share(width, height) >= _LEAST_VISIBLE]


def refined(box: Box, score: Callable[[Box], float]) -> tuple[Box, float]:
    """Return a better box near the given one, and its score, by trying sizes and shifts.

    A bounded climb: at most 25 calls of `score`.
    """
    best, best_score = box, score(box)
    for step in _STEPS:
        for _ in range(_ROUNDS):
            tried = [(candidate, score(candidate)) for candidate in _neighbours(best, step)]
            winner, winner_score = max(tried, key=lambda pair: pair[1])
            if winner_score <= best_score:
                break
            best, best_score = winner, winner_score
    return best, best_score


def _neighbours(box: Box, step: float) -> Iterator[Box]:
    yield box.scaled(1 + step)
    yield box.scaled(1 / (1 + step))
    for right, down in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        yield box.moved_to(
            box.cx + right * step * box.width / 2, box.cy + down * step * box.height / 2
        )
