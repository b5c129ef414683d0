"""The checklist for people and for machines."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from types import TracebackType
from typing import Any, Self

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from follower.preflight.check import Result
from follower.preflight.finding import Verdict
from follower.preflight.snapshot import Snapshot
from follower.print_line import print_line

_STYLES = {
    Verdict.PASS: "green",
    Verdict.WARN: "yellow",
    Verdict.FAIL: "bold red",
    Verdict.UNKNOWN: "dim",
}


def checklist(results: Sequence[Result]) -> Table:
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
        table.add_row(f"  {result.check.name}", _mark(result), _words(result))
    return table


def _mark(result: Result) -> Text:
    verdict = result.finding.verdict
    if result.skipped and verdict in (Verdict.FAIL, Verdict.UNKNOWN):
        return Text(f"{verdict}, skipped", "magenta")
    return Text(str(verdict), "bold red" if result.refuses else _STYLES[verdict])


def _words(result: Result) -> Text:
    words = Text(result.finding.why)
    if result.finding.todo:
        words.append(f"\n→ {result.finding.todo}", "cyan")
    return words


def refusals(results: Sequence[Result]) -> list[str]:
    """Return for each check that refuses: its name, why, and what to do."""
    return [_line(result) for result in results if result.refuses]


def _line(result: Result) -> str:
    finding = result.finding
    todo = f"; {finding.todo}" if finding.todo else ""
    return f"{result.check.name}: {finding.why}{todo}"


def print_checklist(console: Console, results: Sequence[Result]) -> None:
    """Write the table and the verdict; the one line that counts comes last."""
    console.print(checklist(results))
    console.print()
    refused = refusals(results)
    doubtful = (Verdict.WARN, Verdict.FAIL)
    warnings = sum(result.finding.verdict in doubtful for result in results)
    if refused:
        console.print(Text(f"Do not fly: {_count(len(refused), 'check')} failed", "bold red"))
        for line in refused:
            print_line(console, f"  {line}")
    else:
        also = f", {_count(warnings, 'warning')}" if warnings else ""
        console.print(Text(f"Ready{also}", "bold green"))


def to_json(results: Sequence[Result], snapshot: Snapshot) -> str:
    """Return everything for machines."""
    content = {
        "ready": not any(result.refuses for result in results),
        "checks": [
            {
                "name": result.check.name,
                "group": result.check.group,
                "rule": result.check.rule,
                "needed": result.check.needed,
                "skipped": result.skipped,
                "refuses": result.refuses,
                **asdict(result.finding),
            }
            for result in results
        ],
        "vehicle_id": snapshot.link.vehicle_id,
        "autopilot": snapshot.link.autopilot,
        "parameters": dict(snapshot.parameters),
        "camera": asdict(snapshot.camera),
        "computer": asdict(snapshot.computer),
    }
    return json.dumps(_finite(content), indent=2)


def _finite(plain: Any) -> Any:
    """Return the same with null where a number is not finite, which JSON cannot say."""
    if isinstance(plain, dict):
        return {key: _finite(value) for key, value in plain.items()}
    if isinstance(plain, list | tuple):
        return [_finite(value) for value in plain]
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"


class LiveChecklist:
    """Redraws the checklist while the checks settle; on a terminal alone."""

    def __init__(self, console: Console) -> None:
        self._live: Live | None = None
        if console.is_terminal:
            self._live = Live(console=console, auto_refresh=False, transient=True)

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, results: list[Result]) -> None:
        """Show what is known so far."""
        if self._live is not None:
            self._live.update(checklist(results), refresh=True)
