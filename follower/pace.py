"""Simulated time that passes no faster than real time."""

from __future__ import annotations

from follower_vision.clock import Clock, MonotonicClock

_FORGIVEN_S = 0.5


class Pace:
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
