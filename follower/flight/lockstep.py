"""Runs everything on one simulated clock: no threads, no sleeping, the same each time."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable

from follower_vision.clock import SimulatedClock


class Lockstep:
    """An event queue. Events of the same time run in the order in which they were added."""

    def __init__(self, clock: SimulatedClock) -> None:
        self._clock = clock
        self._order = itertools.count()
        self._events: list[tuple[float, int, Callable[[], None]]] = []

    def at(self, time_s: float, action: Callable[[], None]) -> None:
        """Run `action` once, at `time_s` on the simulated clock, not before now."""
        due_s = max(time_s, self._clock.now())
        heapq.heappush(self._events, (due_s, next(self._order), action))

    def every(self, period_s: float, action: Callable[[], None], start_s: float = 0.0) -> None:
        """Run `action` at start + n · period, without drift.

        Raises:
            ValueError: the period is not positive.
        """
        if not period_s > 0:
            raise ValueError(f"a period is positive, not {period_s}")

        times = (start_s + number * period_s for number in itertools.count())

        def run() -> None:
            action()
            self.at(next(times), run)

        self.at(next(times), run)

    def run(self, until: Callable[[], bool]) -> None:
        """Run events in the order of their times until `until()` says so, or none is left."""
        while self._events and not until():
            time_s, _, action = heapq.heappop(self._events)
            self._clock.sleep_until(time_s)
            action()
