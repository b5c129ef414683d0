"""Time is handed in: one monotonic clock for the whole system, or a simulated one."""

import time
from typing import Protocol


class Clock(Protocol):
    """A monotonic clock in seconds; its zero is arbitrary."""

    def now(self) -> float:
        """Return the present time in seconds."""
        ...

    def sleep_until(self, time_s: float) -> None:
        """Return once `now() >= time_s`, in seconds."""
        ...


_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""Of clocks that nobody sets, the one that goes on while the computer sleeps: in a flight that was
suspended, frames, telemetry and heartbeats are as old as they are."""


class MonotonicClock:
    """The computer's clock that nobody sets, counted from when this object was made.

    Args:
        speed: how many of its seconds pass in a real one; not 1 for a simulation in fast motion.

    Attributes:
        speed: the same.
    """

    def __init__(self, speed: float = 1.0) -> None:
        self.speed = speed
        self._origin = time.clock_gettime(_CLOCK)

    def now(self) -> float:
        """Return the seconds since the clock was made."""
        return (time.clock_gettime(_CLOCK) - self._origin) * self.speed

    def sleep_until(self, time_s: float) -> None:
        """Sleep until `time_s` in seconds, or not at all if that has passed."""
        remaining = (time_s - self.now()) / self.speed
        if remaining > 0:
            time.sleep(remaining)


class SimulatedClock:
    """A clock that stands still until it is set: lockstep runs and tests."""

    def __init__(self, start_s: float = 0.0) -> None:
        self._now = start_s

    def now(self) -> float:
        """Return the simulated time in seconds."""
        return self._now

    def sleep_until(self, time_s: float) -> None:
        """Jump to `time_s` in seconds; time never runs backwards."""
        self._now = max(self._now, time_s)
