"""Trackers over all open sequences, many starts each, with intervals and folds that are fixed.

    python benchmarks/fusion_cv.py FOLDER… --tracker NAME [--tracker NAME …] [--out runs/fusion_cv]
    python benchmarks/fusion_cv.py FOLDER… --tracker fusion:MOTION --models runs/train/NAME
    python benchmarks/fusion_cv.py --compare NAME NAME [--out runs/fusion_cv]

Each FOLDER holds sequences (`img/` and `groundtruth.txt`). NAME is as in `follower evaluate
--trackers`. With `--models`, the folder of a `follower train fusion … --folds
benchmarks/multi_start/folds.json`, Fusion's model on a sequence is the one that was fitted without
its fold. Prints success, precision, AUC, expected overlap, "tracking" at an overlap of 0 and the
calibration error with 95 % bootstrap intervals over sequences; with several names also a paired
test of each against the first, and what choosing the best one on four folds gives on the fifth
(`multi_start/folds.json`). Every configuration that is scored goes into `multi_start/history.jsonl`
with its commit, so that the number of looks is known.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path

import command_line
import numpy as np
from multi_start import (
    calibration_error,
    expected_overlap,
    from_rows,
    pooled_interval,
    run_all,
    starts,
    to_rows,
)
from rich.progress import track as progress

from follower.apps.evaluate.contender import Contender
from follower.training.fusion.driving import run_fusion
from follower.training.fusion.settings import FusionSetup
from follower.workers import LocalEngine
from follower_vision.clock import MonotonicClock
from follower_vision.evaluation.intervals import interval, paired_difference
from follower_vision.evaluation.multi_start import Run, sequence_figures
from follower_vision.fusion.model import model_for

HERE = Path(__file__).parent / "multi_start"
FOLDS: dict[str, int] = json.loads((HERE / "folds.json").read_text("utf-8"))
HISTORY = HERE / "history.jsonl"
Results = dict[str, list[Run]]


def main() -> None:
    """Measure what was asked for, and print it."""
    options = _options()
    if options.compare:
        _print([(name, _stored(options.out, name)) for name in options.compare])
        return
    if not options.tracker:
        raise SystemExit("name a tracker: --tracker nanotrack-v3")
    folders = [one for folder in options.folders for one in sorted(folder.iterdir())]
    unknown = [one.name for one in folders if one.name not in FOLDS]
    if unknown or not folders:
        raise SystemExit(f"no fold in {HERE / 'folds.json'} for: {', '.join(unknown) or 'nothing'}")
    options.out.mkdir(parents=True, exist_ok=True)
    measured = []
    for name in options.tracker:
        clock = MonotonicClock()
        measure = _plain(name, options) if options.models is None else _out_of_fold(name, options)
        results = _measure(name, folders, measure, options.jobs)
        name = f"{name}{options.label}"
        stored = {sequence: to_rows(runs) for sequence, runs in results.items()}
        (options.out / f"{_file(name)}.json").write_text(json.dumps(stored), "utf-8")
        measured.append((name, results))
        _remember(name, results, clock.now())
    _print(measured)


def _options() -> argparse.Namespace:
    parser = command_line.parser(__doc__)
    parser.add_argument("folders", type=Path, nargs="*", help="folders of sequences")
    parser.add_argument("--tracker", action="append", default=[], help="as in follower evaluate")
    parser.add_argument("--detector", default="yolox-nano", help="for trackers that want one")
    parser.add_argument("--models", type=Path, help="folder of a `follower train fusion`")
    parser.add_argument("--label", default="", help="is put behind the names, as +appearance")
    parser.add_argument("--compare", nargs=2, help="two that were measured before")
    parser.add_argument("--out", type=Path, default=Path("runs/fusion_cv"))
    parser.add_argument("--jobs", type=command_line.count, default=2, help="processes")
    return parser.parse_args()


Measure = Callable[[Path], tuple[str, list[Run]]]


def _plain(name: str, options: argparse.Namespace) -> Measure:
    return partial(run_all, make=Contender(name, options.detector).make)


def _out_of_fold(name: str, options: argparse.Namespace) -> Measure:
    """Runs of Fusion, each by the model that has not seen the sequence."""
    contender = Contender(name, options.detector)
    setup = FusionSetup(contender.motion, contender.network)
    return partial(_fusion_runs, setup=setup, models=options.models)


def _fusion_runs(folder: Path, setup: FusionSetup, models: Path) -> tuple[str, list[Run]]:
    model = model_for(setup.tracker, str(models / f"fold-{FOLDS[folder.name]}.json"))
    return folder.name, run_fusion(folder, setup, model, models / "detections", starts)


def _measure(name: str, folders: list[Path], measure: Measure, jobs: int) -> Results:
    with closing(LocalEngine(jobs, longest_s=86400.0)) as engine:
        done = progress(engine.run(measure, folders), name, total=len(folders))
        return dict(sorted(one.result for one in done))


def _print(measured: list[tuple[str, Results]]) -> None:
    for name, results in measured:
        print(f"{name}: {len(results)} sequences, {sum(map(len, results.values()))} runs")
        for what, (value, low, high) in _summary(results).items():
            print(f"  {what:15} {value:.3f}  [{low:.3f}, {high:.3f}]")
    first_name, first = measured[0]
    for name, results in measured[1:]:
        shared = sorted(set(first) & set(results))
        for what in ("success", "precision", "auc"):
            gain = paired_difference(_values(results, shared, what), _values(first, shared, what))
            print(
                f"{name} - {first_name}: {what} {gain.mean:+.3f} "
                f"[{gain.low:+.3f}, {gain.high:+.3f}] p {gain.p:.3f}"
            )
    if len(measured) > 1:
        print(f"chosen on the other folds: success {_chosen(measured):.3f} out of fold")


def _summary(results: Results) -> dict[str, tuple[float, float, float]]:
    names = sorted(results)
    rows = {}
    for what in ("success", "precision", "auc", "believed_at_0"):
        values = _values(results, names, what)
        rows[what] = (float(values.mean()), *interval(values))
    by_sequence = [results[name] for name in names]
    rows["expected_overlap"] = pooled_interval(by_sequence, expected_overlap)
    rows["calibration"] = pooled_interval(by_sequence, calibration_error)
    return rows


def _values(results: Results, names: list[str], what: str) -> np.ndarray:
    return np.array([sequence_figures(results[name])[what] for name in names])


def _chosen(measured: list[tuple[str, Results]]) -> float:
    """The success out of fold of whatever was best on the other folds."""
    scores = []
    for fold in sorted(set(FOLDS.values())):
        inside = [name for name in measured[0][1] if FOLDS[name] == fold]
        others = [name for name in measured[0][1] if FOLDS[name] != fold]
        if inside and others:
            best = max(measured, key=lambda one: _values(one[1], others, "success").mean())
            scores += _values(best[1], inside, "success").tolist()
    return float(np.mean(scores)) if scores else math.nan


def _remember(name: str, results: Results, seconds: float) -> None:
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        capture_output=True,
        text=True,
        cwd=HERE,
        check=False,
    ).stdout.strip()
    summary = {what: round(value[0], 4) for what, value in _summary(results).items()}
    row = {"configuration": name, "commit": commit, "sequences": len(results), **summary}
    with HISTORY.open("a", encoding="utf-8") as file:
        file.write(json.dumps({**row, "seconds": round(seconds)}) + "\n")


def _stored(folder: Path, name: str) -> Results:
    path = folder / f"{_file(name)}.json"
    if not path.is_file():
        raise SystemExit(f"{path} is not there: measure {name} first")
    return {sequence: from_rows(rows) for sequence, rows in json.loads(path.read_text()).items()}


def _file(name: str) -> str:
    return name.replace("/", "_").replace(":", "-").replace("+", "-")


if __name__ == "__main__":
    command_line.run(main)
