"""How large a target is, from where the ground says that it stands."""

from __future__ import annotations

import math

_ENOUGH = 30


class KnownSize:
    """The size that fits a target's ranges by the ground, the mean of its first sightings.

    Later ones teach nothing: where the ground rises, the target only seems to grow.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget it."""
        self._log_m: float | None = None
        self._count = 0

    @property
    def log_m(self) -> float | None:
        """Logarithm of the size in metres; None before anything is known."""
        return self._log_m

    def set(self, size_m: float) -> None:
        """Take a size that somebody knows."""
        self._log_m, self._count = math.log(size_m), _ENOUGH

    def assume(self, range_m: float, log_scale: float) -> None:
        """Take a distance for the true one, until there is better or if there was."""
        if self._log_m is None:
            self._log_m = math.log(range_m) + log_scale

    def learn(self, range_m: float, log_scale: float) -> None:
        """Take in at what distance it was seen how large."""
        if self._count >= _ENOUGH:
            return
        self._count += 1
        log_m = math.log(range_m) + log_scale
        before = log_m if self._log_m is None or self._count == 1 else self._log_m
        self._log_m = before + (log_m - before) / self._count

    def range_m(self, log_scale: float) -> float:
        """Return how far away it is where it is seen so large; infinite before it is known."""
        return math.inf if self._log_m is None else math.exp(self._log_m - log_scale)
