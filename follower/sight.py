"""What a simulated flight sees by: its camera's pixels, or the truth with noise."""

from __future__ import annotations

from enum import StrEnum

from follower_control.strict_yaml import SettingsError


class Sight(StrEnum):
    """What vision goes by in a simulated flight."""

    PIXELS = "pixels"
    """Trackers look at rendered pictures."""
    TRUTH = "truth+noise"
    """A stand-in tells the true box with noise; nothing looks at a pixel."""

    @classmethod
    def of(cls, text: str) -> Sight:
        """Return the one of this name.

        Raises:
            SettingsError: there is none.
        """
        try:
            return cls(text)
        except ValueError:
            raise SettingsError(f"--vision {text}: choose {' or '.join(cls)}") from None
