"""How far an estimate of the target may be flown by."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from follower_control.estimate import TargetEstimate


@dataclass(frozen=True, slots=True)
class TrustSettings:
    """Between which values trust falls from one to nothing.

    Attributes:
        sure_deg: up to this standard deviation of its direction an estimate is fully trusted.
        unsure_deg: from this one on it is not.
        fresh_s: likewise, how long the target has not been seen.
        old_s: likewise.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    sure_deg: float = 3.0
    unsure_deg: float = 8.0
    fresh_s: float = 0.4
    old_s: float = 2.0

    def __post_init__(self) -> None:
        if not all(0 < getattr(self, field.name) < math.inf for field in fields(self)):
            raise ValueError(f"the limits of trust are finite and positive, not {self}")
        if self.sure_deg >= self.unsure_deg or self.fresh_s >= self.old_s:
            raise ValueError("sure_deg < unsure_deg and fresh_s < old_s do not hold")


def trust_in(estimate: TargetEstimate, settings: TrustSettings) -> float:
    """Return what share of the largest speed may be flown on an estimate, 0 to 1."""
    variance = max(float(estimate.covariance[0, 0]), float(estimate.covariance[1, 1]))
    doubt_deg = math.degrees(math.sqrt(max(variance, 0.0))) if math.isfinite(variance) else math.inf
    by_direction = _falling(doubt_deg, settings.sure_deg, settings.unsure_deg)
    return min(by_direction, _falling(estimate.age_s, settings.fresh_s, settings.old_s))


def _falling(value: float, full: float, none: float) -> float:
    return min(max((none - value) / (none - full), 0.0), 1.0)
