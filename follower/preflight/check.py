"""One check of the table, and what came of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from follower.preflight.finding import Finding, Verdict
from follower.preflight.snapshot import Snapshot

BOTH = ("px4", "ardupilot")


@dataclass(frozen=True, slots=True)
class Check:
    """One check.

    Attributes:
        name: for `--skip-preflight`.
        group: heading under which it stands.
        rule: what it wants, in a sentence.
        judge: looks at the snapshot.
        needed: nobody flies while it fails or is unknown.
        autopilots: for which it is meant.
        parameters: of the autopilot that it looks at; the first one that there is.
    """

    name: str
    group: str
    rule: str
    judge: Callable[[Snapshot], Finding]
    needed: bool = True
    autopilots: tuple[str, ...] = BOTH
    parameters: tuple[str, ...] = ()

    def concerns(self, snapshot: Snapshot) -> bool:
        """Whether it is meant for this vehicle."""
        return self.autopilots == BOTH or snapshot.link.autopilot in self.autopilots


@dataclass(frozen=True, slots=True)
class Result:
    """What came of a check.

    Attributes:
        check: which one.
        finding: what it said.
        skipped: the user takes the responsibility.
    """

    check: Check
    finding: Finding
    skipped: bool = False

    @property
    def refuses(self) -> bool:
        """Whether nobody may fly because of it."""
        bad = self.finding.verdict in (Verdict.FAIL, Verdict.UNKNOWN)
        return bad and self.check.needed and not self.skipped
