"""Whether the web page that has to be there while following is there."""

from __future__ import annotations

from follower.cockpit.settings import CockpitSettings


class CockpitWatch:
    """Hears the page in control, from step to step.

    Args:
        settings: whether its loss matters, and after how long.
    """

    def __init__(self, settings: CockpitSettings) -> None:
        self._matters = settings.when_lost == "hold"
        self._lost_s = settings.lost_s
        self._heard = False
        self._heard_s: float | None = None

    def hear(self) -> None:
        """Note that it is there; may be called from any thread."""
        self._heard = True

    def is_lost(self, now_s: float) -> bool:
        """Return whether it is missed; a page that never came is."""
        if self._heard:
            self._heard = False
            self._heard_s = now_s
        silent = self._heard_s is None or now_s - self._heard_s > self._lost_s
        return self._matters and silent
