"""How far the pursuit is from what is wanted."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ServoErrors:
    """What the servo saw of the pursuit at its last update, for logs and displays.

    Attributes:
        azimuth_rad: target right of the nose is positive.
        elevation_rad: target above where it is wanted is positive.
        log_range: logarithm of the range over the wanted range; too far is positive.
        range_m: distance to the target, as good as `target_size_m` is.
        target_speed_m_s: the target's own speed away from us; 0 without telemetry.
        range_deviation_m: standard deviation of `range_m`.
        is_level: whether the target's size agrees with the range by the ground, if that counts.
    """

    azimuth_rad: float
    elevation_rad: float
    log_range: float
    range_m: float
    target_speed_m_s: float
    range_deviation_m: float = 0.0
    is_level: bool = True

    @property
    def least_range_m(self) -> float:
        """The distance, taken to be a standard deviation less: what it is safe to count on."""
        return max(self.range_m - self.range_deviation_m, 0.0)

    @property
    def sure_speed_m_s(self) -> float:
        """The target's speed away from us as far as it is safe to count on.

        On ground that rises a target seems to run away, for its distance seems to grow.
        """
        return self.target_speed_m_s if self.is_level else min(self.target_speed_m_s, 0.0)
