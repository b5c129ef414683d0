"""What came of faults and of random flights, kept in files from run to run."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TypeVar

from pydantic import TypeAdapter, ValidationError

from follower.simulation.fault_tests.random_flight import STEP_S, FlightResult
from follower.simulation.faults.judge import FaultVerdict
from follower.ui.terminal.console import counted
from follower_control.common.strict_config import SettingsError
from follower_vision.disk import write_whole

KeptT = TypeVar("KeptT")


def _read(path: Path, kind: TypeAdapter[KeptT]) -> KeptT:
    try:
        return kind.validate_json(path.read_bytes())
    except ValidationError:
        raise SettingsError(
            f"{path}: these are no results of `follower faults`: move the file away, or give "
            "another --out"
        ) from None


@dataclass(frozen=True, slots=True)
class FaultResult:
    """One case: which flight, and what came of its fault."""

    flavour: str
    link: str
    realtime: bool
    verdict: FaultVerdict

    @property
    def key(self) -> str:
        """What distinguishes it from other cases."""
        how = "real time" if self.realtime else "lockstep"
        return f"{self.verdict.fault}, {self.flavour}, {self.link}, {how}"


_CASES = TypeAdapter(list[FaultResult])


class Results:
    """Cases by their keys; a case flown anew takes the old one's place.

    Args:
        path: the JSON file; read if it exists.

    Raises:
        SettingsError: it holds something else.
        OSError: it cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._cases: dict[str, FaultResult] = {}
        if path.exists():
            for case in _read(path, _CASES):
                self._cases[case.key] = case

    def __iter__(self) -> Iterator[FaultResult]:
        return iter(self._cases.values())

    def add(self, result: FaultResult) -> None:
        """Take a case and write the file.

        Raises:
            OSError: it cannot be written.
        """
        self._cases[result.key] = result
        self._path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(self._path, _CASES.dump_json([*self], indent=1).decode() + "\n")


@dataclass(slots=True)
class Tally:
    """Sums over flights.

    Attributes:
        seed: of the campaign.
        flights: flown so far: those with the numbers 0 to `flights` - 1.
        steps: of control.
        engaged_steps: of them, with setpoints by which the vehicle flew.
        setpoints: that went over the wire.
        after_pilot_s: the longest time from a heartbeat of another mode to the last setpoint.
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
        """Read it, or begin anew if there is none.

        Args:
            path: of the JSON file.
            seed: whose flights are to be added; None takes those of any.

        Raises:
            SettingsError: the file holds something else, or flights of another seed.
            OSError: it cannot be read.
        """
        if not path.exists():
            return cls(seed=seed or 0)
        tally = _read(path, TypeAdapter(cls))
        if seed not in (None, tally.seed):
            kept = counted(tally.flights, "flight")
            raise SettingsError(
                f"{path}: {kept} of seed {tally.seed} are kept there: go on with --seed "
                f"{tally.seed}, or give another --out"
            )
        return tally
