"""What speaks for a box, and what it is worth."""

from __future__ import annotations

from dataclasses import dataclass

from follower_vision.box import Box
from follower_vision.fusion.settings import FusionSettings

CERTAIN = 0.98
"""A motion tracker whose confidence reaches this share of its usual one is certain."""

SURE = 0.95
"""One that reaches this share is sure."""

_SURER = 0.01
_MARGIN = 0.1
_ALIKE = 0.8
_VERY_ALIKE = 0.9


@dataclass(frozen=True, slots=True)
class Evidence:
    """What speaks for the motion tracker's box.

    Attributes:
        box: the box.
        confidence: the tracker's confidence.
        relative: its confidence as a share of the usual one.
        score: its re-identification score, 0 to 2.
        looks: that score as a share of the usual one.
        blurred: whether blur makes the score a weak witness.
        fresh: whether the score is this frame's.
    """

    box: Box
    confidence: float
    relative: float
    score: float
    looks: float
    blurred: bool = False
    fresh: bool = True


class Judge:
    """Weighs a box's looks against the motion tracker's confidence in it."""

    def __init__(self, settings: FusionSettings, epsilon: float) -> None:
        """Make one for which a re-identification score of `epsilon` is the target's."""
        self._settings = settings
        self._epsilon = epsilon

    def unlike(self, evidence: Evidence) -> bool:
        """Whether the box looks so little like the target that it is doubtful."""
        certain = evidence.relative >= CERTAIN or evidence.blurred
        least = self._settings.doubt_ratio_sure if certain else self._settings.doubt_ratio
        return evidence.looks < least and evidence.score < self._epsilon - _MARGIN

    def alike(self, evidence: Evidence) -> bool:
        """Whether the box looks so much like the target that doubt ends."""
        least = _ALIKE if evidence.score >= self._epsilon else _VERY_ALIKE
        return evidence.looks >= least

    def rivals(self, relative: float, evidence: Evidence) -> bool:
        """Whether the tracker is about as sure of another place as of the one followed."""
        return relative >= evidence.relative - _SURER

    def surpasses(self, rival: Evidence, evidence: Evidence) -> bool:
        """Whether another place is rather the target than the one followed."""
        surer = self.rivals(rival.relative, evidence)
        return surer and self.alike(rival) and rival.score > evidence.score
