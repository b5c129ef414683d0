"""`follower train fusion`: rounds of runs and fits, and the score out of fold."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
import yaml
from pydantic import TypeAdapter
from rich.console import Console

from follower.training.fusion.driving import Examples, driven, ends, read_sequence, run_fusion
from follower.training.fusion.fitting import FirstPeak, fit_model, fit_noise
from follower.training.fusion.settings import FusionConfig, FusionSetup
from follower.training.trainer import CONFIG
from follower.workers import LocalEngine, job_progress
from follower_control.common.strict_config import SettingsError
from follower_vision.disk import write_whole
from follower_vision.evaluation.multi_start import Run, sequence_figures
from follower_vision.fusion.model import CandidateModel, ProbabilityModel, family_of, model_for
from follower_vision.geometry.box import Box

FITTED = "fitted.json"
_FOLD = "fold-{}.json"
_LONGEST_S = 86400.0
_LOG_ROUNDS = 3
"""Runs of older rounds are forgotten: their models went other ways than the last one will."""
NameT = TypeVar("NameT")
ResultT = TypeVar("ResultT")


@dataclass(frozen=True, slots=True)
class FittedFusion:
    """What a training has given.

    Attributes:
        path: the file with the model.
        runs: of models that had not seen the sequence, by setup and sequence.
    """

    path: Path
    runs: Mapping[FusionSetup, Mapping[str, list[Run]]]

    def figures(self, setup: FusionSetup) -> dict[str, float]:
        """Return a setup's mean figures over the sequences, out of fold."""
        rows = [sequence_figures(runs) for runs in self.runs[setup].values()]
        return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}


class FusionTrainer:
    """Fits Fusion's model to runs over annotated sequences that it drives itself.

    Every round runs all sequences, each by the model of the round before that was fitted without
    it, and fits anew to the runs of the last rounds. A track that has lost its target is put back
    on it after `RESET_FRAMES`. Fitted on runs that the annotation drives, a model fails (success
    0.64 instead of 0.83): it never sees the situations that its own mistakes lead to.

    Args:
        config: the recipe.
        folders: each one sequence, with its true boxes.
        folder: where everything is written.
        folds: number of each sequence's fold, by name; None deals them by name.
        choices: written down elsewhere, as in simulated flights; every fit learns from them too.
        begin: folder of an earlier fit with the same folds, whose models drive the first round;
            None: it follows the motion tracker's best place.

    Raises:
        SettingsError: there are too few sequences, or one cannot be read.
        ModelError: a model of the earlier fit cannot be read.
    """

    def __init__(
        self,
        config: FusionConfig,
        folders: Sequence[Path],
        folder: Path,
        folds: Mapping[str, int] | None = None,
        choices: Sequence[Examples] = (),
        begin: Path | None = None,
    ) -> None:
        self._choices = list(choices)
        self._config, self._folder = config, folder
        self._places = {one.name: one for one in folders}
        self._folds = _dealt(self._places, config.folds, folds)
        self._truths = {name: read_sequence(place).truth for name, place in self._places.items()}
        self._models = {fold: self._first_model(fold, begin) for fold in set(self._folds.values())}

    def train(self) -> FittedFusion:
        """Do all rounds, score out of fold, and write the model that was fitted to everything."""
        self._folder.mkdir(parents=True, exist_ok=True)
        resolved = yaml.safe_dump(self._config.model_dump(mode="json"), sort_keys=False)
        (self._folder / CONFIG).write_text(resolved, encoding="utf-8")
        rounds: list[dict[str, Examples]] = []
        for number in range(self._config.rounds):
            words = f"round {number + 1} of {self._config.rounds}"
            rounds = [*rounds, self._driven(words)][-_LOG_ROUNDS:]
            self._fit_folds(rounds, words)
        everything = fit_one(
            [self._joined(rounds, name) for name in self._places],
            [self._truths[name] for name in self._places],
            self._config,
            self._choices,
        )
        path = self._folder / FITTED
        family = family_of(self._config.setups[0].tracker)
        made = {"recipe": self._config.model_dump(mode="json"), "folds": self._folds}
        write_whole(path, json.dumps({"models": {family: everything.to_json()}, **made}))
        for fold, model in self._models.items():
            if isinstance(model, CandidateModel):
                stored = {"models": {family: model.to_json()}}
                write_whole(self._folder / _FOLD.format(fold), json.dumps(stored))
        return FittedFusion(path, self._scored())

    def _first_model(self, fold: int, begin: Path | None) -> ProbabilityModel:
        if begin is None:
            return FirstPeak()
        return model_for(self._config.setups[0].tracker, str(begin / _FOLD.format(fold)))

    def _fit_folds(self, rounds: list[dict[str, Examples]], words: str) -> None:
        jobs = {
            fold: partial(
                fit_one,
                [self._joined(rounds, name) for name in self._others(fold)],
                [self._truths[name] for name in self._others(fold)],
                self._config,
                self._choices,
            )
            for fold in self._models
        }
        self._models.update(self._spread(jobs, f"{words}: fit"))

    def _others(self, fold: int) -> Iterator[str]:
        return (name for name in self._places if self._folds[name] != fold)

    def _joined(self, rounds: list[dict[str, Examples]], name: str) -> Examples:
        return Examples.joined(one[name] for one in rounds)

    def _driven(self, words: str) -> dict[str, Examples]:
        jobs = {
            name: partial(driven, place, self._config.setups, self._model(name), self._cache)
            for name, place in self._places.items()
        }
        return self._spread(jobs, f"{words}: runs")

    def _scored(self) -> dict[FusionSetup, dict[str, list[Run]]]:
        found = {}
        for setup in self._config.setups:
            jobs = {
                name: partial(run_fusion, place, setup, self._model(name), self._cache, ends)
                for name, place in self._places.items()
            }
            found[setup] = self._spread(jobs, f"score of {setup.tracker}")
        return found

    def _model(self, name: str) -> ProbabilityModel:
        return self._models[self._folds[name]]

    @property
    def _cache(self) -> Path:
        return self._folder / "detections"

    def _spread(
        self, jobs: Mapping[NameT, Callable[[], ResultT]], words: str
    ) -> dict[NameT, ResultT]:
        """Do jobs in processes; the results come in the jobs' order."""
        results: dict[NameT, ResultT] = {}
        shown = job_progress(Console(), words, len(jobs), things="jobs")
        with closing(LocalEngine(self._config.jobs, _LONGEST_S)) as engine, shown as count_one:
            for done in engine.run(_done, jobs.items()):
                results[done.job[0]] = done.result
                count_one()
        return {name: results[name] for name in jobs}


def sequence_folders(folders: Iterable[Path]) -> list[Path]:
    """Return the folders of sequences in some folders, in the order of their names.

    Raises:
        SettingsError: one is no folder, or two sequences have one name.
    """
    found: dict[str, Path] = {}
    for folder in folders:
        if not folder.is_dir():
            raise SettingsError(f"--sequences {folder}: there is no such folder")
        for place in sorted(folder.iterdir()):
            if place.name in found:
                raise SettingsError(f"{place} and {found[place.name]}: rename one of them")
            if place.is_dir():
                found[place.name] = place
    return [found[name] for name in sorted(found)]


def read_choices(folder: Path) -> list[Examples]:
    """Read all files of choices in a folder, in the order of their names.

    Raises:
        SettingsError: there is none, or one cannot be used.
    """
    paths = sorted(folder.glob("*.npz"))
    if not paths:
        raise SettingsError(f"--choices {folder}: there is no .npz file of choices in it")
    return [Examples.load(path) for path in paths]


def read_folds(path: Path) -> dict[str, int]:
    """Read each sequence's fold from a JSON file, {"name": number}.

    Raises:
        SettingsError: the file cannot be used.
    """
    try:
        return TypeAdapter(dict[str, int]).validate_json(path.read_bytes())
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else 'write {"name": fold, …}'
        raise SettingsError(f"--folds {path}: {reason}") from None


def fit_one(
    logs: Sequence[Examples],
    truths: Sequence[Sequence[Box | None]],
    config: FusionConfig,
    choices: Sequence[Examples],
) -> CandidateModel:
    """Fit the noise to runs over some sequences, and the model to other choices too."""
    torch.set_num_threads(1)
    return fit_model([*logs, *choices], fit_noise(logs, truths), config.fit)


def _dealt(names: Iterable[str], count: int, given: Mapping[str, int] | None) -> dict[str, int]:
    """Each sequence's fold."""
    missing = sorted(set(names) - set(given)) if given is not None else []
    if missing:
        raise SettingsError(f"--folds: no fold for {', '.join(missing)}")
    folds = {
        name: given[name] if given is not None else zlib.crc32(name.encode()) % count
        for name in names
    }
    if len(set(folds.values())) < 2:
        raise SettingsError(
            f"{len(folds)} sequences in one fold: at least two folds are needed; give more "
            "sequences, or their folds by --folds"
        )
    return folds


def _done(job: tuple[Any, Callable[[], ResultT]]) -> ResultT:
    return job[1]()
