"""All checks, in their order, and what comes of them."""

from collections.abc import Collection, Iterable, Sequence
from typing import Any

import pydantic_core
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from follower.apps.preflight.camera_checks import CAMERA
from follower.apps.preflight.check import (
    BOTH,
    PreflightCheck,
    PreflightFinding,
    PreflightResult,
    PreflightVerdict,
    Snapshot,
    refusals,
    unknown,
)
from follower.apps.preflight.computer_checks import COMPUTER
from follower.apps.preflight.health_checks import AUTOPILOT, LINK
from follower.apps.preflight.parameter_checks import PARAMETERS
from follower.ui.ipc.messages import Message
from follower.ui.terminal.console import counted, print_line
from follower_control.common.strict_config import SettingsError

CHECKS: tuple[PreflightCheck[Snapshot], ...] = (
    *LINK.checks,
    *AUTOPILOT.checks,
    *PARAMETERS.checks,
    *CAMERA.checks,
    *COMPUTER.checks,
)
_OF_VEHICLE = {check.name for check in (*LINK.checks, *AUTOPILOT.checks)} - {"vehicle"}


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


def run_checks(snapshot: Snapshot, skip: Collection[str] = ()) -> list[PreflightResult]:
    """Judge a snapshot by every check that concerns its vehicle, in the table's order."""
    return [
        PreflightResult(check, _finding(check, snapshot), check.name in skip)
        for check in CHECKS
        if check.autopilots == BOTH or snapshot.link.autopilot in check.autopilots
    ]


def _finding(check: PreflightCheck[Snapshot], snapshot: Snapshot) -> PreflightFinding:
    """Judge by one check; what a vehicle would have to say is unknown without one."""
    if snapshot.link.vehicle_id is None and check.name in _OF_VEHICLE:
        return unknown("no vehicle is heard")
    return check.judge(snapshot)


_STYLES = {
    PreflightVerdict.PASS: "green",
    PreflightVerdict.WARN: "yellow",
    PreflightVerdict.FAIL: "bold red",
    PreflightVerdict.UNKNOWN: "dim",
}


def checklist(results: Sequence[PreflightResult]) -> Table:
    """Return all results as a table."""
    table = Table(show_edge=False, pad_edge=False, header_style="dim", box=None)
    table.add_column("Check", no_wrap=True)
    table.add_column("", no_wrap=True)
    table.add_column("Why, and what to do", overflow="fold")
    group = ""
    for result in results:
        if result.check.group != group:
            group = result.check.group
            table.add_row(Text(group, "bold"))
        words = Text(result.finding.why)
        if result.finding.todo:
            words.append(f"\n→ {result.finding.todo}", "cyan")
        table.add_row(f"  {result.check.name}", _mark(result), words)
    return table


def _mark(result: PreflightResult) -> Text:
    verdict = result.finding.verdict
    if result.skipped and verdict in (PreflightVerdict.FAIL, PreflightVerdict.UNKNOWN):
        return Text(f"{verdict}, skipped", "magenta")
    if verdict is PreflightVerdict.FAIL and not result.refuses:
        return Text(f"{verdict}, optional", "yellow")
    return Text(str(verdict), "bold red" if result.refuses else _STYLES[verdict])


def print_checklist(
    console: Console,
    results: Sequence[PreflightResult],
    good: str = "Ready",
    bad: str = "Do not fly",
) -> None:
    """Write the table and the verdict; the one line that counts comes last.

    Args:
        console: where to.
        results: of all checks.
        good: the verdict if nothing refuses.
        bad: the verdict if something does.
    """
    console.print(checklist(results))
    console.print()
    refused = [result for result in results if result.refuses]
    doubtful = (PreflightVerdict.WARN, PreflightVerdict.FAIL)
    warnings = sum(result.finding.verdict in doubtful for result in results)
    if refused:
        console.print(Text(f"{bad}: {counted(len(refused), 'check')} failed", "bold red"))
        for line in refusals(refused):
            print_line(console, f"  {line}")
    else:
        also = f", {counted(warnings, 'warning')}" if warnings else ""
        console.print(Text(f"{good}{also}", "bold green"))


def to_json(results: Sequence[PreflightResult], snapshot: Snapshot | None = None) -> str:
    """Return everything for machines; a number that is not finite is null.

    Args:
        results: of all checks.
        snapshot: that they judged, if there is a vehicle.
    """
    content: dict[str, Any] = {
        "ready": not any(result.refuses for result in results),
        "checks": [
            {
                "name": result.check.name,
                "group": result.check.group,
                "rule": result.check.rule,
                "needed": result.check.needed,
                "skipped": result.skipped,
                "refuses": result.refuses,
                "verdict": result.finding.verdict,
                "why": result.finding.why,
                "todo": result.finding.todo,
            }
            for result in results
        ],
    }
    if snapshot is not None:
        content |= {
            "vehicle_id": snapshot.link.vehicle_id,
            "autopilot": snapshot.link.autopilot,
            "parameters": dict(snapshot.parameters),
            "camera": snapshot.camera,
            "computer": snapshot.computer,
        }
    return pydantic_core.to_json(content, indent=2, inf_nan_mode="null").decode()


def live_checklist(console: Console) -> Live:
    """Return what redraws the checklist while the checks settle; on a terminal alone."""
    return Live(console=console, auto_refresh=False, transient=True)


def check_list(results: Iterable[PreflightResult]) -> list[Message]:
    """Return preflight checks as the page lists them."""
    return [
        {
            "name": one.check.name,
            "verdict": "warn" if one.skipped else str(one.finding.verdict),
            "text": " – ".join(text for text in (one.finding.why, one.finding.todo) if text),
        }
        for one in results
    ]
