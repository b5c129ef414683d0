"""How a NanoTrack network's answer becomes a box."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True, slots=True)
class NanoTrackSettings:
    """The constants of SiamTrackers' NanoTrack, as its author tuned them for version 2.

    Attributes:
        window_influence: weight of nearness to the last place against likeness, 0 to 1.
        penalty_k: how much a change of size or shape costs.
        learning_rate: how fast the size follows what is seen, 0 to 1.
        context: margin about the target, as a share of width plus height.
        smallest_side_px: a box's sides never become shorter.
        candidates: how many places `candidates` tells at most.
        candidate_score: the least likeness of a candidate, 0 to 1.
        candidate_overlap: largest intersection over union of two candidates.
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    window_influence: float = 0.490
    penalty_k: float = 0.150
    learning_rate: float = 0.385
    context: float = 0.5
    smallest_side_px: float = 3.0
    candidates: int = 5
    candidate_score: float = 0.1
    candidate_overlap: float = 0.3

    def __post_init__(self) -> None:
        for name in ("window_influence", "learning_rate", "candidate_score", "candidate_overlap"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be from 0 to 1, not {getattr(self, name)}")
        for name in ("penalty_k", "context"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must not be negative, nor infinite")
        if not 0 < self.smallest_side_px < math.inf:
            raise ValueError("smallest_side_px must be positive")
        if self.candidates < 1:
            raise ValueError("candidates must be at least 1")


NANOTRACK_SETTINGS = {
    1: NanoTrackSettings(window_influence=0.462, penalty_k=0.148, learning_rate=0.390),
    2: NanoTrackSettings(window_influence=0.490, penalty_k=0.150, learning_rate=0.385),
    3: NanoTrackSettings(window_influence=0.455, penalty_k=0.138, learning_rate=0.348),
}
"""The published settings of each version, from SiamTrackers' configuration files."""
