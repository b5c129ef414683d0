"""Settings of the long-term tracker."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar

from follower_vision.blur import BlurSettings
from follower_vision.framecheck import FrameCheckSettings
from follower_vision.reidentify import ReidentifySettings


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
        looks_doubt_s: the same, where only the looks are in doubt, not the confidence.
        look_every_s: while the motion tracker is sure, the looks are compared this often.
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

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    def __post_init__(self) -> None:
        if not 0 <= self.low_ratio <= self.high_ratio <= 1:
            raise ValueError("long-term tracker: 0 <= low_ratio <= high_ratio <= 1 has to hold")
        if not self.reject_score <= self.recognised_score <= 2:
            raise ValueError("long-term tracker: reject_score <= recognised_score <= 2 has to hold")
        if not 0 <= self.least_visible < 1:
            raise ValueError("long-term tracker: least_visible lies between 0 and 1")
        for name in ("doubt_s", "look_every_s", "coast_s", "refresh_s", "reach", "size_jump"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"long-term tracker: {name} has to be 0 or more")
