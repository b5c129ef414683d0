"""How often something may happen."""

from __future__ import annotations

from follower_vision.clock import Clock


class Limiter:
    """A token bucket: `burst` at once, `rate_hz` in the long run."""

    def __init__(self, rate_hz: float, burst: int, clock: Clock) -> None:
        self._rate_hz = rate_hz
        self._burst = float(burst)
        self._clock = clock
        self._left = self._burst
        self._since_s = clock.now()

    @property
    def is_used_up(self) -> bool:
        """Whether `allows` would say no."""
        self._refill()
        return self._left < 1

    @property
    def is_full(self) -> bool:
        """Whether it is as if it had never been asked."""
        self._refill()
        return self._left == self._burst

    def allows(self) -> bool:
        """Whether it may happen once more now."""
        if self.is_used_up:
            return False
        self._left -= 1
        return True

    def _refill(self) -> None:
        now_s = self._clock.now()
        self._left = min(self._burst, self._left + (now_s - self._since_s) * self._rate_hz)
        self._since_s = now_s
