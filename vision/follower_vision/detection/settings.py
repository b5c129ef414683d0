"""What a detector reports."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True, slots=True)
class DetectorSettings:
    """Which of a network's answers count.

    Attributes:
        min_score: weaker detections are dropped, 0 to 1.
        max_overlap: largest intersection over union of two detections of one class, 0 to 1.
        most: how many detections are reported at most.
        drop_cut: leave out what the region's edge cuts, instead of marking it.
        edge_px: how near to the edge a box counts as cut, in pixels of the network's input.
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    min_score: float = 0.3
    max_overlap: float = 0.45
    most: int = 100
    drop_cut: bool = False
    edge_px: float = 2.0

    def __post_init__(self) -> None:
        for name in ("min_score", "max_overlap"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be from 0 to 1, not {getattr(self, name)}")
        if self.most < 1:
            raise ValueError(f"most must be at least 1, not {self.most}")
        if not 0 <= self.edge_px < float("inf"):
            raise ValueError(f"edge_px must not be negative, nor infinite, not {self.edge_px}")
