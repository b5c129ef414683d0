"""What a run of a campaign has to reach."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, ClassVar

from follower.campaign.figures import Figures


@dataclass(frozen=True, slots=True)
class Goals:
    """Limits for each run, and for the share of occlusions of the whole campaign.

    Attributes:
        min_in_frame_share: least share of the time with the target in frame, occlusions left out.
        max_line_of_sight_rms_deg: largest root mean square of the line-of-sight error of the true
            box's middle, occlusions left out, what follows them included.
        occlusion_s: occlusions up to this length have to be got over ...
        reacquired_s: ... within this time of their end, ...
        reacquired_share: ... this share of all of them.
        max_violations: most violations of the envelope in a run.
        keep_out: whether a run fails that came nearer to the target than the keep-out.
    """

    min_in_frame_share: float = 0.99
    max_line_of_sight_rms_deg: float = 3.0
    occlusion_s: float = 3.0
    reacquired_s: float = 1.0
    reacquired_share: float = 0.98
    max_violations: int = 0
    keep_out: bool = True

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    def __post_init__(self) -> None:
        for field in fields(self):
            if not 0 <= getattr(self, field.name) < math.inf:
                raise ValueError(f"a goal's {field.name} is not negative")
            if field.name.endswith("_share") and getattr(self, field.name) > 1:
                raise ValueError(f"a goal's {field.name} is a share: at most 1")

    def failures(self, figures: Figures) -> list[str]:
        """Return which goals a run missed, by the figures' names; none if it reached them all."""
        if figures.time_to_acquire_s is None:
            return ["never followed"]
        if figures.approach_s is None:
            return ["never approached"]
        share, angle = figures.in_frame_share, figures.line_of_sight_box_rms_seen_deg
        found = {
            "in frame": share is None or share < self.min_in_frame_share,
            "line of sight": angle is None or angle > self.max_line_of_sight_rms_deg,
            "re-acquisition": self.late(figures) > 0,
            "envelope": figures.envelope_violations > self.max_violations,
            "keep-out": self.keep_out and figures.is_too_near,
        }
        return [name for name, failed in found.items() if failed]

    def short(self, figures: Figures) -> list[float | None]:
        """Return the times to re-acquisition after the occlusions that count."""
        pairs = zip(figures.occlusion_s, figures.reacquired_s, strict=True)
        return [took for length, took in pairs if length <= self.occlusion_s]

    def late(self, figures: Figures) -> int:
        """Return after how many of them the target was not seen in time."""
        return sum(took is None or took > self.reacquired_s for took in self.short(figures))
