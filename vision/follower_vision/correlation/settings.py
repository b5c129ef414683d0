"""What can be set on the correlation tracker."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True)
class CorrelationSettings:
    """Settings of the correlation tracker; the defaults serve all kinds of targets.

    Attributes:
        patch_px: side of the square into which the search region is scaled, in pixels.
        cell_px: side of a feature cell in the patch, in pixels.
        search_factor: side of the search region over the target's side (square of equal area).
        gradient_channels: principal components kept of the 31 gradient channels.
        colour_channels: principal components kept of the 12 colour channels.
        label_sigma: width of the wanted response over the target's side.
        learning_rate: share of the newest sample in the model.
        colour_share: greatest share of the colour likelihood in the response.
        colour_learning_rate: share of the newest sample in the colour histograms.
        regularisation: weight of the filter's norm.
        iterations: ADMM iterations per training.
        scale_count: sizes compared per frame, odd.
        scale_step: ratio of neighbouring sizes.
        scale_learning_rate: share of the newest sample in the scale model.
        scale_regularisation: weight of the scale filter's norm.
        minimum_side_px: the box's shorter side does not shrink below this.
        noise_ratio: a peak to sidelobe ratio below this is noise, and the box stays where it was.
        doubtful_share: at this share of the usual ratio and below, nothing is learnt.
        full_share: at this share of the usual ratio and above, learning is at its full rate.
        drift_share: share of the target's mean step by which the search region moves ahead.
        drift_rate: share of the newest step in the mean step.

    Raises:
        ValueError: a number is out of its range.
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    patch_px: int = 200
    cell_px: int = 4
    search_factor: float = 5.0
    gradient_channels: int = 12
    colour_channels: int = 4
    label_sigma: float = 1 / 16
    learning_rate: float = 0.02
    colour_share: float = 0.5
    colour_learning_rate: float = 0.02
    regularisation: float = 1e-4
    iterations: int = 2
    scale_count: int = 17
    scale_step: float = 1.035
    scale_learning_rate: float = 0.025
    scale_regularisation: float = 0.01
    minimum_side_px: float = 3.0
    noise_ratio: float = 4.5
    doubtful_share: float = 0.45
    full_share: float = 0.8
    drift_share: float = 0.5
    drift_rate: float = 0.5

    def __post_init__(self) -> None:
        if self.cell_px < 2 or self.patch_px % self.cell_px or self.patch_px < 8 * self.cell_px:
            raise ValueError("patch_px is a multiple of cell_px (2 or more), at least 8 cells")
        if not 1 <= self.gradient_channels <= 31 or not 1 <= self.colour_channels <= 12:
            raise ValueError("gradient_channels are 1 to 31 and colour_channels 1 to 12")
        if self.scale_count < 3 or self.scale_count % 2 == 0:
            raise ValueError("scale_count is an odd number from 3")
        if self.search_factor < 1.5 or self.scale_step <= 1 or self.iterations < 1:
            raise ValueError(
                "search_factor is 1.5 or more, scale_step above 1, iterations 1 or more"
            )
        if not 0 <= self.doubtful_share < self.full_share:
            raise ValueError("doubtful_share is 0 or more and full_share above it")
        self._check_positive()
        self._check_shares()

    def _check_positive(self) -> None:
        for name in (
            "label_sigma",
            "regularisation",
            "scale_regularisation",
            "minimum_side_px",
        ):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} is positive, not {getattr(self, name)}")

    def _check_shares(self) -> None:
        for name in (
            "learning_rate",
            "scale_learning_rate",
            "drift_share",
            "drift_rate",
            "colour_share",
            "colour_learning_rate",
        ):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} lies between 0 and 1, not {getattr(self, name)}")
