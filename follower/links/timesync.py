"""TIMESYNC: asking the autopilot for its time."""

from __future__ import annotations

import statistics
from collections import deque

from follower.links.autopilot_clock import AutopilotClock

_MOST_OPEN = 20
_SHOWN = 10
_EARLY_S = 1e-3


class TimeSync:
    """Asks at a steady rate and tells the clock what the answers bound.

    An answer counts once and only to a question of ours, so that late duplicates and inventions
    change nothing.

    Args:
        clock: is told.
        rate_hz: how often to ask.
    """

    def __init__(self, clock: AutopilotClock, rate_hz: float) -> None:
        self._clock = clock
        self._period_s = 1.0 / rate_hz
        self._asked_s = float("-inf")
        self._open: dict[int, float] = {}
        self._round_trips_s: deque[float] = deque(maxlen=_SHOWN)

    @property
    def round_trip_s(self) -> float | None:
        """Median of the last ten round trips, the wait for our next look included."""
        trips = tuple(self._round_trips_s)
        return statistics.median(trips) if trips else None

    def question(self, now_s: float) -> int | None:
        """Return the `ts1` (nanoseconds) of a question that is due now, None if none is."""
        if now_s - self._asked_s < self._period_s - _EARLY_S:
            return None
        self._asked_s = now_s
        stamp = time_ns(now_s)
        self._open[stamp] = now_s
        if len(self._open) > _MOST_OPEN:
            del self._open[next(iter(self._open))]
        return stamp

    def answer(self, tc1: int, ts1: int, now_s: float) -> None:
        """Take an answer: the autopilot's time and our question, both in nanoseconds."""
        asked_s = self._open.pop(ts1, None)
        if asked_s is None or now_s < asked_s:
            return
        self._round_trips_s.append(now_s - asked_s)
        self._clock.exchange(asked_s, tc1 / 1e9, now_s)


def time_ns(now_s: float) -> int:
    """Return a time as TIMESYNC carries it; never 0, which means a question."""
    return max(1, round(now_s * 1e9))
