"""What came of a fault: the failures in words, and the figures."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Figures:
    """What was measured, in seconds and metres; None where it does not apply.

    Attributes:
        hold_s: from the fault's begin to the first hold on the wire.
        wire_s: from the decision to hold to the hold on the wire.
        rest_s: from the fault's begin to the vehicle's standing still.
        excursion_m: how far it went until then.
        back_s: from the fault's end until the target is followed again.
        after_pilot_s: from the heartbeat that tells of the pilot's mode to the last set-point.
        setpoints: how many went over the wire.
    """

    hold_s: float | None = None
    wire_s: float | None = None
    rest_s: float | None = None
    excursion_m: float | None = None
    back_s: float | None = None
    after_pilot_s: float | None = None
    setpoints: int = 0


@dataclass(frozen=True, slots=True)
class Verdict:
    """One fault in one flight.

    Attributes:
        fault: its name, with time and duration if they were chosen.
        must: the sentence; "" if the flight was held against what always holds alone.
        failures: what was not so, in sentences; none is a pass.
        figures: what was measured.
        end: the supervisor's last state and reason.
    """

    fault: str
    must: str
    failures: tuple[str, ...]
    figures: Figures
    end: str

    @property
    def passed(self) -> bool:
        """Whether all was as it must be."""
        return not self.failures
