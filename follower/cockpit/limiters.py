"""How often something may happen, by whom."""

from __future__ import annotations

from collections import OrderedDict

from follower.cockpit.limiter import Limiter
from follower_vision.clock import Clock

_MOST = 256


class Limiters:
    """A `Limiter` for each one who asks, so that nobody uses up another one's.

    At most 256 are kept; who has not asked for long enough to be as new is forgotten. While there
    are more than that, those who come later share one.

    Args:
        rate_hz: of each.
        burst: of each.
        clock: this process's.
    """

    def __init__(self, rate_hz: float, burst: int, clock: Clock) -> None:
        self._rate_hz, self._burst, self._clock = rate_hz, burst, clock
        self._kept: OrderedDict[str, Limiter] = OrderedDict()
        self._shared = self._new()

    def __getitem__(self, who: str) -> Limiter:
        """The limiter of somebody."""
        if who not in self._kept:
            self._forget()
            if len(self._kept) >= _MOST:
                return self._shared
            self._kept[who] = self._new()
        self._kept.move_to_end(who)
        return self._kept[who]

    def _forget(self) -> None:
        while self._kept and next(iter(self._kept.values())).is_full:
            self._kept.popitem(last=False)

    def _new(self) -> Limiter:
        return Limiter(self._rate_hz, self._burst, self._clock)
