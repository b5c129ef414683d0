"""Runs everything on one simulated clock: no threads, no sleeping, the same each time."""

import heapq
import itertools
from collections.abc import Callable

from follower_vision.clock import Clock, MonotonicClock, SimulatedClock


class Lockstep:
    """An event queue. Events of the same time run in the order in which they were added."""

    def __init__(self, clock: SimulatedClock) -> None:
        self._clock = clock
        self._order = itertools.count()
        self._events: list[tuple[float, int, Callable[[], None]]] = []

    def at(self, time_s: float, action: Callable[[], None]) -> None:
        """Run `action` once, at `time_s` (seconds, simulated clock), not before now."""
        due_s = max(time_s, self._clock.now())
        heapq.heappush(self._events, (due_s, next(self._order), action))

    def every(self, period_s: float, action: Callable[[], None]) -> None:
        """Run `action` at n · period, in seconds, without drift.

        Raises:
            ValueError: the period is not positive.
        """
        if not period_s > 0:
            raise ValueError(f"a period is positive, not {period_s}")

        times = (number * period_s for number in itertools.count())

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


_FORGIVEN_S = 0.5


class Pacer:
    """Waits until the real clock has come as far as the simulated one.

    After a longer delay it goes on at real speed, without catching up.

    Args:
        simulated: runs ahead.
        real: is waited for.
    """

    def __init__(self, simulated: Clock, real: Clock | None = None) -> None:
        self._simulated = simulated
        self._real = real or MonotonicClock()
        self._start_s = self._real.now() - simulated.now()

    def wait(self) -> None:
        """Wait, if there is need to."""
        due_s = self._start_s + self._simulated.now()
        behind_s = self._real.now() - due_s
        if behind_s > _FORGIVEN_S:
            self._start_s += behind_s
        elif behind_s < 0:
            self._real.sleep_until(due_s)
