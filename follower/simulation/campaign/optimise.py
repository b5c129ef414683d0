"""Searches settings with a smaller cost, by Optuna, over the campaign's own runs."""

import json
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import yaml
from rich.console import Console

from follower.settings.settings import Settings, nested
from follower.simulation.campaign.config import (
    CampaignConfig,
    OptimiseSettings,
    RunSpec,
    significant,
)
from follower.simulation.campaign.fly import INTERRUPTED, STOPPED, fly_runs, print_errors
from follower.simulation.campaign.metrics import RunMetrics
from follower.simulation.campaign.store import RunStore
from follower.simulation.campaign.summary import cost
from follower.ui.terminal.console import needed, print_line
from follower.workers import Engine, job_progress
from follower_control.common.strict_config import SettingsError, merged, read_mapping
from follower_vision.disk import write_whole

BEST = "best.yaml"
TRIALS = "trials.json"
_SUCCESS, _FAILED = 0, 1
_NOT_FLOWN = 20.0


class Trial(NamedTuple):
    """One set of values that was tried.

    Attributes:
        cost: mean over the runs.
        values: by the settings' keys.
    """

    cost: float
    values: dict[str, float]


def optimise(
    config: CampaignConfig,
    specs: Sequence[RunSpec],
    engine: Engine,
    store: RunStore,
    folder: Path,
    console: Console,
) -> int:
    """Search, write the best settings, and return the exit code.

    The first trial has the settings that the campaign's first run flies with. All trials fly the
    same runs, so that luck does not choose between them. Optuna's sampler is seeded and every run
    is kept: a search that was stopped goes on where it was.

    Raises:
        SettingsError: the campaign's file says nothing of what to search.
    """
    wanted = config.optimise
    if wanted is None:
        raise SettingsError("--optimise: the campaign's file has no section `optimise`")
    flown = specs[: wanted.runs_per_trial]
    study, ranges = _study(flown[0], wanted)
    trials: list[Trial] = []
    rows: list[dict[str, Any]] = []
    stopped = suppress(KeyboardInterrupt)
    shown = job_progress(console, config.name, wanted.trials, things="trials")
    with stopped, shown as count_one:
        for _ in range(wanted.trials):
            asked = study.ask(ranges)
            values = {key: significant(value) if isinstance(value, float) else value
                      for key, value in asked.params.items()}  # fmt: skip
            tried = _flown(flown, values, engine, store)
            rows += tried
            trials.append(Trial(_mean_cost(tried), values))
            study.tell(asked, trials[-1].cost)
            count_one()
    if trials:
        _write(trials, folder, {} if config.config is None else read_mapping(config.config))
        _say(trials, folder, console)
    errors = [row["error"] for row in rows if row["error"]]
    print_errors(errors, len(rows), console)
    if len(trials) == wanted.trials:
        return _FAILED if errors else _SUCCESS
    console.print(STOPPED)
    return INTERRUPTED


def _study(run: RunSpec, wanted: OptimiseSettings) -> tuple[Any, dict[str, Any]]:
    """Return a study whose first trial is what there is now, and what is tried of each setting.

    Raises:
        SettingsError: what there is now lies outside of what is to be tried.
    """
    optuna = needed("optuna")
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    sampler = optuna.samplers.TPESampler(seed=wanted.seed)
    study = optuna.create_study(sampler=sampler)
    _, now = run.options().resolve()
    first = {key: present(now, key) for key in wanted.settings}
    ranges = {}
    for key, (low, high) in wanted.settings.items():
        if not low <= first[key] <= high:
            raise SettingsError(
                f"optimise.settings: {key} is {first[key]:g}, which is not between {low:g} and "
                f"{high:g}"
            )
        ranges[key] = (
            optuna.distributions.IntDistribution(math.ceil(low), math.floor(high))
            if isinstance(first[key], int)
            else optuna.distributions.FloatDistribution(low, high)
        )
    study.enqueue_trial(first)
    return study, ranges


def present(settings: Settings, key: str) -> float | int:
    """Return the number that a setting has now, an int if it is always whole.

    Raises:
        SettingsError: there is no such setting, or it is no number.
    """
    value: Any = settings
    for part in key.split("."):
        value = getattr(value, part, None)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise SettingsError(f"optimise.settings: {key!r} is no setting with a number")
    return value


def _flown(
    specs: Sequence[RunSpec], values: dict[str, float], engine: Engine, store: RunStore
) -> list[dict[str, Any]]:
    """Return the runs' rows with these values; what was flown so before is not flown again."""
    changes = tuple(f"{key}={value}" for key, value in values.items())
    tried = [replace(spec, overrides=(*spec.overrides, *changes)) for spec in specs]
    for row in fly_runs(engine, [spec for spec in tried if not store.has(spec.key)]):
        store.add(row)
    return [store.rows[spec.key] for spec in tried]


def _mean_cost(rows: Sequence[dict[str, Any]]) -> float:
    costs = [_NOT_FLOWN if row["error"] else cost(RunMetrics.from_dict(row)) for row in rows]
    return sum(costs) / len(costs)


def _write(trials: Sequence[Trial], folder: Path, best: dict[str, Any]) -> None:
    """Write all trials, and the best one's values among the settings of the campaign's file."""
    listed = [{"cost": trial.cost, **trial.values} for trial in trials]
    write_whole(folder / TRIALS, json.dumps(listed, indent=1) + "\n")
    for key, value in min(trials, key=lambda trial: trial.cost).values.items():
        best = merged(best, nested(key.split("."), value))
    write_whole(folder / BEST, yaml.safe_dump(best, sort_keys=False))


def _say(trials: Sequence[Trial], folder: Path, console: Console) -> None:
    first, best = trials[0], min(trials, key=lambda trial: trial.cost)
    print_line(console, f"Cost {first.cost:.3f} before, {best.cost:.3f} after {len(trials)} trials")
    for key, value in best.values.items():
        print_line(console, f"  {key}: {first.values[key]:g} → {value:g}")
    print_line(console, f"  {folder / BEST}: for `follower sim --config`")
