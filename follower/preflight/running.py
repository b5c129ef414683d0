"""Runs the table's checks."""

from __future__ import annotations

from collections.abc import Collection, Iterable

from follower.preflight.check import Result
from follower.preflight.snapshot import Snapshot
from follower.preflight.table import CHECKS
from follower_control.strict_yaml import SettingsError


def parameters_for(autopilot: str) -> tuple[tuple[str, ...], ...]:
    """Return what to read of an autopilot; of each group one name will do."""
    return tuple(c.parameters for c in CHECKS if c.parameters and autopilot in c.autopilots)


def check_names(names: Iterable[str]) -> frozenset[str]:
    """Return the names of checks to skip.

    Raises:
        SettingsError: there is no check of that name.
    """
    known = {check.name for check in CHECKS}
    wanted = frozenset(names)
    for name in sorted(wanted - known):
        listed = ", ".join(check.name for check in CHECKS)
        raise SettingsError(f"--skip-preflight {name}: no such check; there are {listed}")
    return wanted


def run_checks(snapshot: Snapshot, skip: Collection[str] = ()) -> list[Result]:
    """Judge a snapshot by every check that concerns its vehicle, in the table's order."""
    checks = [check for check in CHECKS if check.concerns(snapshot)]
    return [Result(check, check.judge(snapshot), check.name in skip) for check in checks]
