"""`follower campaign`: fly what is planned and not yet flown, keep it, and report on it."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from follower.campaign.campaign_config import CampaignConfig, load_campaign
from follower.campaign.dask_engine import DaskEngine
from follower.campaign.engine import Engine
from follower.campaign.extra import needed
from follower.campaign.figures import Figures
from follower.campaign.goals import Goals
from follower.campaign.local_engine import LocalEngine
from follower.campaign.plan import planned
from follower.campaign.progress import CampaignProgress
from follower.campaign.run_spec import RunSpec
from follower.campaign.store import Store
from follower.campaign.summary import Summary, summary_of
from follower.campaign.tables import RESULTS, write_parquet
from follower.configs import find_scenario
from follower.print_line import print_line
from follower.report.writer import REPORT, write_whole
from follower.sight import Sight, check_without_pixels
from follower.simulate import simulate, simulation_settings
from follower_sim.scenario_file import load_scenario

WORST = "worst"
CONFIG = "campaign.yaml"
_SUCCESS, _FAILED, _INTERRUPTED = 0, 1, 130


@dataclass(frozen=True, slots=True)
class CampaignOptions:
    """What the command line was given; see `follower campaign --help`."""

    campaign: str
    workers: int = 1
    scheduler: str | None = None
    vision: str | None = None
    runs: int | None = None
    out: Path | None = None
    videos: int = 0
    optimise: bool = False


def run_campaign(options: CampaignOptions) -> int:
    """Fly, write the results and the report, and return the exit code.

    Raises:
        SettingsError: the campaign, a scenario or a setting cannot be used.
    """
    needed("pyarrow")
    config = load_campaign(options.campaign, vision=options.vision, runs=options.runs)
    specs = planned(config)
    check(specs)
    folder = options.out or Path("runs") / f"campaign-{config.name}"
    console = Console()
    with Store(folder) as store, closing(make_engine(options)) as engine:
        write_whole(folder / CONFIG, config_text(config))
        if options.optimise:
            from follower.campaign.optimise import optimise

            return optimise(config, specs, engine, store, folder, console)
        try:
            fly_missing(specs, engine, store, console, config.name)
        except KeyboardInterrupt:
            console.print("Stopped; what is finished is kept, and the same command goes on.")
            return _INTERRUPTED
        rows = judged([in_its_place(store.rows[spec.key], spec) for spec in specs], config.goals)
    return _finish(config, rows, specs, folder, options.videos, console)


def make_engine(options: CampaignOptions) -> Engine:
    """Return where the runs are flown."""
    if options.scheduler is not None:
        return DaskEngine(options.scheduler)
    return LocalEngine(options.workers)


def check(specs: Sequence[RunSpec]) -> None:
    """Resolve one run of each scenario, so that what is mistyped is refused before all flying.

    Raises:
        SettingsError: names the key that cannot be used.
    """
    for spec in {spec.scenario: spec for spec in reversed(specs)}.values():
        scenario = load_scenario(find_scenario(spec.scenario), spec.scene)
        simulation_settings(scenario, spec.options())
        if spec.sight == Sight.TRUTH:
            check_without_pixels(scenario)


def fly_missing(
    specs: Sequence[RunSpec], engine: Engine, store: Store, console: Console, title: str
) -> None:
    """Fly those of the runs whose rows are not in the store, or tell of an error."""
    missing = [spec for spec in specs if not _is_whole(store.rows.get(spec.key))]
    with CampaignProgress(console, title, len(specs), len(specs) - len(missing)) as progress:
        for row in engine.fly(missing):
            store.add(row)
            progress.finished()


def _is_whole(row: dict[str, Any] | None) -> bool:
    """Whether a row has every figure; one from before a figure was thought of has not."""
    return row is not None and not row["error"] and set(Figures.__dataclass_fields__) <= set(row)


def in_its_place(row: dict[str, Any], spec: RunSpec) -> dict[str, Any]:
    """Return a row with its place in this campaign, which may have been another when it was flown.

    The same flight can be another run, by parameters of other names, once the file was edited.
    """
    return {**row, "number": spec.number, "values": dict(spec.values), "command": spec.command}


def judged(rows: Sequence[dict[str, Any]], goals: Goals) -> list[dict[str, Any]]:
    """Return the rows with what each run missed, and whether it passed."""
    return [_judged(row, goals) for row in rows]


def _judged(row: dict[str, Any], goals: Goals) -> dict[str, Any]:
    if row["error"]:
        return {**row, "failures": ["error"], "passed": False}
    failures = goals.failures(Figures.from_dict(row))
    return {**row, "failures": failures, "passed": not failures}


def config_text(config: CampaignConfig) -> str:
    """Return a campaign as resolved, as YAML."""
    import yaml

    return yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)


def _finish(
    config: CampaignConfig,
    rows: Sequence[dict[str, Any]],
    specs: Sequence[RunSpec],
    folder: Path,
    videos: int,
    console: Console,
) -> int:
    """Write results and report, fly the worst with video, and say what came of it."""
    from follower.report.campaign import render

    summary = summary_of(rows, config.goals)
    write_parquet(folder / RESULTS, rows)
    numbers = [row["number"] for row in summary.worst[:videos]]
    by_number = {spec.number: spec for spec in specs}
    seen = {number: fly_with_video(by_number[number], folder) for number in numbers}
    write_whole(folder / REPORT, render(config, rows, summary, seen))
    say(summary, folder, console)
    return _SUCCESS if summary.reached else _FAILED


def fly_with_video(spec: RunSpec, folder: Path) -> str:
    """Fly a run again with video and report; return the folder of both, seen from `folder`."""
    place = folder / WORST / f"{spec.number:04d}"
    shutil.rmtree(place, ignore_errors=True)
    simulate(spec.options(out=place, record=False))
    (flown,) = place.iterdir()
    return flown.relative_to(folder).as_posix()


def say(summary: Summary, folder: Path, console: Console) -> None:
    """Print the goals, met or not, and where everything lies."""
    for line in summary.lines:
        style = "green" if line.met else "bold red"
        wanted = f", wanted {line.wanted}: [{style}]{line.verdict}[/]" if line.counts else ""
        console.print(f"{line.name}: {line.value}{wanted}", highlight=False, soft_wrap=True)
    if summary.errors:
        error = next(str(row["error"]) for row in summary.worst if row["error"])
        said = f"{summary.errors} of {summary.runs} runs could not be flown, the first one: {error}"
        print_line(console, said, "bold red")
    for name in (REPORT, RESULTS):
        print_line(console, f"  {folder / name}")
