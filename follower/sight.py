"""What a simulated flight sees by: its camera's pixels, or the truth with noise."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

from follower_control.strict_yaml import SettingsError
from follower_sim.scenario import Scenario


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


def check_without_pixels(scenario: Scenario, faults: Sequence[str] = ()) -> None:
    """Refuse what nobody could see without pixels.

    Raises:
        SettingsError: a fault of the camera was asked for.
    """
    kinds = {fault.kind for fault in scenario.faults} & {"black", "frozen"}
    if kinds or faults:
        named = faults[0] if faults else f"the scenario's fault {sorted(kinds)[0]!r}"
        raise SettingsError(f"--vision {Sight.TRUTH}: {named} needs pixels; leave --vision out")
