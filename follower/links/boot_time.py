"""The autopilot's clock seen from ours."""

from __future__ import annotations


class BootTime:
    """Maps an autopilot's time since boot to the system's clock.

    A message arrives at its own time plus a delay that is never negative: the smallest
    (arrival - boot) seen is the best offset. It may relax by `drift` so that a crystal that runs
    slow is followed.
    """

    def __init__(self, drift: float = 1e-4) -> None:
        self._drift = drift
        self._offset: float | None = None
        self._boot_s = 0.0

    def to_system(self, boot_s: float, arrival_s: float) -> float:
        """Return when `boot_s` was, in seconds on the clock that gave `arrival_s`."""
        offset = arrival_s - boot_s
        rebooted = boot_s < self._boot_s - 1.0
        if self._offset is None or rebooted:
            self._offset = offset
        else:
            relaxed = self._offset + self._drift * max(0.0, boot_s - self._boot_s)
            self._offset = min(relaxed, offset)
        self._boot_s = boot_s if rebooted else max(boot_s, self._boot_s)
        return boot_s + self._offset
