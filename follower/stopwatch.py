"""How long our own code takes, for the log; no decision depends on it."""

from __future__ import annotations

import time


class Stopwatch:
    """Runs from its making on the computer's own clock, also where the system's is simulated."""

    def __init__(self) -> None:
        self._began_s = time.perf_counter()

    def elapsed_s(self) -> float:
        """Return the seconds since the stopwatch was made."""
        return time.perf_counter() - self._began_s
