"""Settings of the stand-in for vision."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, ClassVar


@dataclass(frozen=True, slots=True)
class StandInSettings:
    """How well the stand-in sees. Sizes are shares of the true box's side (root of its area).

    The noise is as measured of the correlation tracker's boxes on the scenarios `pursue-…`.

    Attributes:
        centre_noise: standard deviation of the centre's error, along each axis.
        size_noise: standard deviation of the error of the side's natural logarithm.
        noise_s: time within which both errors change (Gauss-Markov).
        offset: lasting error of the centre, (right, down): where the operator's choice lies.
        size_factor: side of the box over the true one's.
        least_visible: with less than this share of the target visible it is not seen.
        coast_s: how long a box is extrapolated before the target is lost.
        recognise_s: mean time from a lost target's coming back into view until it is recognised.
        false_share: share of the losses in which something else is taken for the target.
        false_after_s: mean time from such a loss until then.
        false_s: how long it is taken for it.
    """

    centre_noise: float = 0.04
    size_noise: float = 0.08
    noise_s: float = 1.5
    offset: tuple[float, float] = (0.0, 0.0)
    size_factor: float = 1.0
    least_visible: float = 0.4
    coast_s: float = 0.5
    recognise_s: float = 0.15
    false_share: float = 0.03
    false_after_s: float = 1.0
    false_s: float = 0.4

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "offset" and not 0 <= value < math.inf:
                raise ValueError(f"the stand-in's {field.name} is not negative, not {value}")
        if not self.size_factor > 0 or self.least_visible > 1 or self.false_share > 1:
            raise ValueError("the stand-in's size_factor is positive, its shares are at most 1")
