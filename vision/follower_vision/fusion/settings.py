"""Settings of Fusion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

Algorithm = Literal["fitted", "paper"]


@dataclass(frozen=True, slots=True)
class FusionSettings:
    """Which algorithm, and how it spends the detector's time.

    Attributes:
        algorithm: "fitted" chooses among candidates by a fitted probability; "paper" is Panda and
            Barczyk's, which has none of the other settings.
        validate_every: frames between two detections while the target is seen.
        doubt_every: the same while it is blurred, doubtful or lost.
        crop_sizes: side of the region that is looked at, in target sizes.
        crop_least_px: its smallest side, in pixels.
        target_prediction: use what control knows of the target's way through the world.
        model: file of `follower train fusion`; None is the model that comes along.
        embedder: name of another package's, which then says how alike things look.
    """

    algorithm: Algorithm = "fitted"
    validate_every: int = 4
    doubt_every: int = 2
    crop_sizes: float = 5.0
    crop_least_px: float = 128.0
    target_prediction: bool = True
    model: str | None = None
    embedder: str | None = None

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    def __post_init__(self) -> None:
        for name in ("validate_every", "doubt_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"fusion: {name} is at least 1")
        for name in ("crop_sizes", "crop_least_px"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"fusion: {name} has to be positive")

    @classmethod
    def paper(cls) -> FusionSettings:
        """Return the paper's algorithm, its slips corrected, without any improvement."""
        return cls(algorithm="paper")
