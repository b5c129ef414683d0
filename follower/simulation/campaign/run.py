"""`follower campaign`: fly what is planned and not yet flown, keep it, and report on it."""

import shutil
from collections.abc import Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from rich.console import Console

from follower.flight.supervision.flight_end import BY_CTRL_C
from follower.recording.run_folder import check_goes_on
from follower.report.flight_page import REPORT
from follower.simulation.campaign.config import (
    CampaignConfig,
    Goals,
    RunSpec,
    planned,
)
from follower.simulation.campaign.fly import INTERRUPTED, STOPPED, fly_runs, print_errors
from follower.simulation.campaign.metrics import RunMetrics
from follower.simulation.campaign.store import RESULTS, ROWS, RunStore, write_parquet
from follower.simulation.campaign.summary import CampaignSummary, summary_of
from follower.simulation.run import simulate
from follower.ui.terminal.console import print_line
from follower.workers import Engine, job_progress
from follower_vision.disk import write_whole

WORST = "worst"
CONFIG = "campaign.yaml"
_SUCCESS, _FAILED = 0, 1


def run_campaign(
    config: CampaignConfig,
    folder: Path,
    engine: Engine,
    videos: int = 0,
    searching: bool = False,
) -> int:
    """Fly, write the results and the report, and return the exit code.

    Args:
        config: what is to be flown.
        folder: of its results; what was flown into it before is not flown again.
        engine: flies the runs, and is closed at the end.
        videos: how many of the worst runs are flown again with video.
        searching: search settings by the campaign's cost instead.

    Raises:
        SettingsError: the campaign, a scenario or a setting cannot be used.
    """
    from follower.simulation.campaign.report import render

    specs = planned(config)
    check(specs)
    check_goes_on(folder, "campaign", CONFIG, ROWS)
    console = Console()
    with closing(engine), RunStore(folder) as store:
        write_whole(folder / CONFIG, config.to_yaml())
        if searching:
            from follower.simulation.campaign.optimise import optimise

            return optimise(config, specs, engine, store, folder, console)
        try:
            fly_missing(specs, engine, store, console, config.name)
        except KeyboardInterrupt:
            console.print(STOPPED)
            return INTERRUPTED
        rows = judged([in_its_place(store.rows[spec.key], spec) for spec in specs], config.goals)
    summary = summary_of(rows, config.goals)
    write_parquet(folder / RESULTS, rows)
    by_number = {spec.number: spec for spec in specs}
    flown = [by_number[row["number"]] for row in summary.worst if not row["error"]]
    seen: dict[int, str] = {}
    with suppress(KeyboardInterrupt):
        for spec in flown[:videos]:
            seen[spec.number] = fly_with_video(spec, folder)
    write_whole(folder / REPORT, render(config, rows, summary, seen))
    print_summary(summary, folder, console)
    for place in seen.values():
        print_line(console, f"  {folder / place / REPORT}")
    if len(seen) < len(flown[:videos]):
        console.print(STOPPED)
        return INTERRUPTED
    if videos and not summary.worst:
        print_line(console, "No run failed: none was flown again with video.")
    return _SUCCESS if summary.reached else _FAILED


def check(specs: Sequence[RunSpec]) -> None:
    """Resolve one run of each scenario, so that what is mistyped is refused before all flying.

    Raises:
        SettingsError: names the key that cannot be used.
    """
    for spec in {spec.scenario: spec for spec in reversed(specs)}.values():
        spec.options().resolve()


def fly_missing(
    specs: Sequence[RunSpec], engine: Engine, store: RunStore, console: Console, title: str
) -> None:
    """Fly those of the runs whose rows are not in the store, or have an error."""
    missing = [spec for spec in specs if not store.has(spec.key)]
    flown = len(specs) - len(missing)
    with job_progress(console, title, len(specs), flown) as count_one:
        for row in fly_runs(engine, missing):
            store.add(row)
            count_one()


def in_its_place(row: dict[str, Any], spec: RunSpec) -> dict[str, Any]:
    """Return a row with its place in this campaign, which may have been another when it was flown.

    The same flight can be another run, by parameters of other names, once the file was edited.
    """
    command = spec.options().command
    return {**row, "number": spec.number, "values": dict(spec.values), "command": command}


def judged(rows: Sequence[dict[str, Any]], goals: Goals) -> list[dict[str, Any]]:
    """Return the rows with what each run missed, and whether it passed."""
    missed = [
        ["error"] if row["error"] else goals.failures(RunMetrics.from_dict(row)) for row in rows
    ]
    return [
        {**row, "failures": failures, "passed": not failures}
        for row, failures in zip(rows, missed, strict=True)
    ]


def fly_with_video(spec: RunSpec, folder: Path) -> str:
    """Fly a run again with video and report; return the folder of both, seen from `folder`.

    Raises:
        KeyboardInterrupt: Ctrl-C ended the flight; nothing of it is left.
    """
    place = folder / WORST / f"{spec.number:04d}"
    shutil.rmtree(place, ignore_errors=True)
    flown = simulate(spec.options(out=place, record=False))
    if flown.end is BY_CTRL_C:
        shutil.rmtree(place)
        raise KeyboardInterrupt
    return flown.folder.relative_to(folder).as_posix()


def print_summary(summary: CampaignSummary, folder: Path, console: Console) -> None:
    """Print the goals, met or not, and where everything lies."""
    for line in summary.lines:
        style = "green" if line.met else "bold red"
        wanted = f", wanted {line.wanted}: [{style}]{line.verdict}[/]" if line.counts else ""
        console.print(f"{line.name}: {line.value}{wanted}", highlight=False, soft_wrap=True)
    errors = [row["error"] for row in summary.worst if row["error"]]
    print_errors(errors, summary.runs, console)
    for name in (REPORT, RESULTS):
        print_line(console, f"  {folder / name}")
