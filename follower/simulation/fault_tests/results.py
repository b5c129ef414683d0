"""What all random flights together came to, kept in a file from run to run."""

from __future__ import annotations

import json
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path

from follower.faults.campaign.flight import STEP_S, FlightResult
from follower.report.writer import write_whole


@dataclass(slots=True)
class Tally:
    """Sums over flights.

    Attributes:
        seed: of the campaign.
        flights: flown so far: those with the numbers 0 to `flights` - 1.
        steps: of control.
        engaged_steps: of them, with set-points by which the vehicle flew.
        setpoints: that went over the wire.
        after_pilot_s: the longest time from a heartbeat of another mode to the last set-point.
        busy_s: how long the computer took.
        failures: flight's number and what was wrong.
        faults: how often each kind of fault began.
        states: control steps in each state.
    """

    seed: int = 0
    flights: int = 0
    steps: int = 0
    engaged_steps: int = 0
    setpoints: int = 0
    after_pilot_s: float = 0.0
    busy_s: float = 0.0
    failures: dict[str, str] = field(default_factory=dict)
    faults: dict[str, int] = field(default_factory=dict)
    states: dict[str, int] = field(default_factory=dict)

    @property
    def minutes(self) -> float:
        """Minutes of flight at 50 control steps a second."""
        return self.steps * STEP_S / 60.0

    def add(self, result: FlightResult, busy_s: float) -> None:
        """Add the next flight."""
        if result.failure:
            self.failures[str(self.flights)] = result.failure
        self.flights += 1
        self.steps += result.steps
        self.engaged_steps += result.engaged_steps
        self.setpoints += result.setpoints
        self.after_pilot_s = max(self.after_pilot_s, result.after_pilot_s)
        self.busy_s += busy_s
        self.faults = dict(Counter(self.faults) + Counter(result.faults))
        self.states = dict(Counter(self.states) + Counter(result.states))

    def save(self, path: Path) -> None:
        """Write it.

        Raises:
            OSError: it cannot be written.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(asdict(self), indent=1) + "\n")

    @classmethod
    def load(cls, path: Path, seed: int | None = None) -> Tally:
        """Read it, or begin anew if there is none or it is not of this seed; None takes any."""
        if path.exists():
            tally = cls(**json.loads(path.read_text("utf-8")))
            if seed in (None, tally.seed):
                return tally
        return cls(seed=seed or 0)
