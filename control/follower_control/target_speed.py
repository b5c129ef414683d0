"""How fast the target itself moves away, from our own speed and the growth of the range."""

from __future__ import annotations

import math


class TargetSpeed:
    """A low-pass of our own speed towards the target plus the rate of the range.

    The rate of the range comes late out of camera, tracker and filter. Our own speed is held back
    by as much, or else our own speeding up would for a moment look like the target's.

    Args:
        filter_s: time constant of the result.
        own_lag_s: time constant by which our own speed is held back.

    Raises:
        ValueError: a time constant is negative or not finite.
    """

    def __init__(self, filter_s: float, own_lag_s: float) -> None:
        self.change(filter_s, own_lag_s)
        self._own: float | None = None
        self._speed = 0.0

    def change(self, filter_s: float, own_lag_s: float) -> None:
        """Go on with other time constants.

        Raises:
            ValueError: a time constant is negative or not finite.
        """
        if not (0 <= filter_s < math.inf and 0 <= own_lag_s < math.inf):
            raise ValueError(f"time constants are not negative: {filter_s}, {own_lag_s}")
        self._filter_s = filter_s
        self._own_lag_s = own_lag_s

    def reset(self) -> None:
        """Forget; the next update takes the target to move as we do."""
        self._own = None

    def update(self, own_speed_m_s: float, range_rate_m_s: float, interval_s: float) -> float:
        """Return the target's speed away from us in m/s; an interval of 0 changes nothing."""
        if self._own is None:
            self._own = self._speed = own_speed_m_s
        elif interval_s > 0:
            self._own += _share(interval_s, self._own_lag_s) * (own_speed_m_s - self._own)
            seen = self._own + range_rate_m_s
            self._speed += _share(interval_s, self._filter_s) * (seen - self._speed)
        return self._speed


def _share(interval_s: float, time_constant_s: float) -> float:
    return interval_s / (interval_s + time_constant_s)
