"""How much to trust observations and estimates; apart from the filter, which is slow to import."""

from dataclasses import dataclass, fields
from typing import Any, ClassVar

from follower_control.common.strict_config import check_positive


@dataclass(frozen=True, slots=True)
class EstimatorSettings:
    """How much to trust the observations, and how much the target is expected to manoeuvre.

    Attributes:
        direction_noise_deg: standard deviation of the direction of a tiny target.
        direction_noise_share: what is added to it, as a share of the target's angular size.
        log_scale_noise: standard deviation of the log scale (0.05 is 5 % in size).
        cut_noise_factor: how much worse all three are when the image's border cuts the box.
        azimuth_acceleration_deg_s2: spectral density of the acceleration, its root per sqrt(Hz).
        elevation_acceleration_deg_s2: the same for elevation.
        log_scale_acceleration_s2: the same for log scale.
        start_rate_deg_s: standard deviation of the unknown angular rates at the start.
        start_log_scale_rate_s: the same for log scale.
        gate: largest accepted squared Mahalanobis distance; 16.27 passes 99.9 % of good
            observations (chi-squared with 3 degrees of freedom).
        gated_in_a_row: so many gated observations in a row restart the filter on the last of them.
        restart_after_s: after so long without an observation there is no estimate, and the next
            observation restarts the filter.
    """

    __pydantic_config__: ClassVar[dict[str, Any]] = {"extra": "forbid"}

    direction_noise_deg: float = 0.1
    direction_noise_share: float = 0.03
    log_scale_noise: float = 0.03
    cut_noise_factor: float = 5.0
    azimuth_acceleration_deg_s2: float = 20.0
    elevation_acceleration_deg_s2: float = 15.0
    log_scale_acceleration_s2: float = 0.15
    start_rate_deg_s: float = 30.0
    start_log_scale_rate_s: float = 0.5
    gate: float = 16.27
    gated_in_a_row: int = 5
    restart_after_s: float = 2.0

    def __post_init__(self) -> None:
        check_positive(self, *(field.name for field in fields(self)))


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
        check_positive(self, *(field.name for field in fields(self)))
        if self.sure_deg >= self.unsure_deg or self.fresh_s >= self.old_s:
            raise ValueError("sure_deg < unsure_deg and fresh_s < old_s do not hold")
