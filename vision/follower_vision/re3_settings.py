"""Settings of our Re3 tracker."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True, slots=True)
class Re3Settings:
    """How the network's answers are used.

    Attributes:
        reset_frames: what the LSTM layers remember goes back to what it was after the first frame
            each time so many frames have passed; the paper's number.
        smallest_side_px: no side of the box becomes shorter, in pixels.
        confidence_power: the confidence is the network's likelihood raised to this. Fusion takes a
            confidence of less than 0.8 of the usual one for a loss: on generated sequences every
            second box has nothing of the target where the likelihood is 0.025 of the usual one
            (benchmarks/re3_confidence.py).
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    reset_frames: int = 32
    smallest_side_px: float = 4.0
    confidence_power: float = 0.06

    def __post_init__(self) -> None:
        if self.reset_frames < 1:
            raise ValueError("reset_frames must be at least 1")
        if not self.smallest_side_px > 0.0:
            raise ValueError("smallest_side_px must be positive")
        if not 0.0 < self.confidence_power <= 1.0:
            raise ValueError("confidence_power must be above 0, and at most 1")
