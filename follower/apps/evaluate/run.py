"""Runs an evaluation: every tracker on every sequence from every start."""

from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import cv2
from rich.console import Console

from follower.apps.evaluate.contender import Contender, EvaluationResult, ResultStore, RunStart, run
from follower.apps.evaluate.output_files import (
    stateless,
    terminal_tables,
    write_csv,
    write_json,
    write_toolkit_files,
)
from follower.apps.evaluate.report import render
from follower.apps.evaluate.scores import (
    Evaluation,
    ScoredRun,
    attribute_rows,
    differences,
    rows,
    scored,
    toolkit_rows,
)
from follower.recording.run_folder import check_goes_on, new_run_folder
from follower.ui.terminal.console import print_line, quiet_console
from follower.workers import Engine, engine_for, job_progress
from follower_control.common.strict_config import SettingsError
from follower_vision.clock import MonotonicClock
from follower_vision.disk import write_whole
from follower_vision.evaluation.datasets import DatasetError, load_dataset, read_boxes
from follower_vision.evaluation.metrics import spatial_starts, temporal_starts
from follower_vision.evaluation.one_pass import Sequence
from follower_vision.plugins import PluginError

_SUCCESS, _INTERRUPTED = 0, 130
_LONGEST_S = 86400.0
_BOXES = "boxes"
_FILES = ("results.csv", "results.json", "report.html")


@dataclass(frozen=True, slots=True)
class EvaluationPlan:
    """What is measured on what; see `follower evaluate --help`.

    Attributes:
        folders: sequences, or folders of them.
        trackers: names of contenders.
        detector: of the contenders that need one and name none.
        boxes: NAME=FOLDER of another program's boxes.
        tre: how many frames to start from, beside the first.
        sre: also start from moved boxes.
        out: takes the run's folder.
        resume: the folder of a run to continue.
        fps: frames a second where the data set does not say.
        workers: processes that run trackers; 0 is this one. They slow one another down.
        dask: a Dask scheduler whose workers do it instead; they have the images at the same place.
    """

    folders: Iterable[Path]
    trackers: Iterable[str]
    detector: str = "yolox-nano"
    boxes: Iterable[str] = ()
    tre: int = 0
    sre: bool = False
    out: Path = Path("runs")
    resume: Path | None = None
    fps: float = 30.0
    workers: int = 0
    dask: str | None = None


def evaluate(plan: EvaluationPlan, console: Console | None = None) -> int:
    """Measure, print the tables to the console, and return the command's exit code.

    Raises:
        SettingsError, ModelError, OSError: see `measure`.
    """
    console = console or Console()
    try:
        found = measure(plan, console)
    except EvaluationInterrupted as interrupted:
        again = f"the same command with --resume {interrupted.folder}"
        print_line(console, f"interrupted; go on with {again}")
        return _INTERRUPTED
    for remark in found.remarks:
        print_line(console, remark, style="yellow")
    for table in terminal_tables(found.means, found.differences):
        console.print(table)
    if stateless(found.means):
        print_line(console, f"no states: {', '.join(stateless(found.means))}", style="dim")
    for name in _FILES:
        print_line(console, f"  {found.folder / name}")
    return _SUCCESS


class EvaluationInterrupted(KeyboardInterrupt):
    """Ctrl-C; what was measured is in `folder`, from which the same evaluation goes on."""

    def __init__(self, folder: Path) -> None:
        super().__init__(f"{folder} holds what was measured: resume from there")
        self.folder = folder


def measure(plan: EvaluationPlan, console: Console | None = None) -> Evaluation:
    """Measure, write the files, and return the figures.

    The console shows the progress; without one nothing is printed.

    Raises:
        SettingsError: a tracker or folder is not there; one line says what to do.
        ModelError: a network is missing.
        OSError: an image cannot be read or a result cannot be written.
        EvaluationInterrupted: Ctrl-C.
    """
    console = console or quiet_console()
    try:
        sequences, remarks = _sequences(plan.folders)
        names = set(plan.trackers)
        others = _others(plan.boxes, plan.fps, sequences, remarks, names)
    except DatasetError as error:
        raise SettingsError(str(error)) from None
    if plan.resume is not None:
        if not plan.resume.is_dir():
            raise SettingsError(f"--resume {plan.resume}: there is no such folder")
        check_goes_on(plan.resume, "evaluation", _BOXES)
    contenders = [
        contender
        for contender in (Contender(name, plan.detector) for name in dict.fromkeys(plan.trackers))
        if _can_be_made(contender, remarks)
    ]
    if not (contenders or others):
        why = "; ".join(remarks) or "give --trackers a,b or --boxes name=folder"
        raise SettingsError(f"nothing to measure: {why}")
    folder = plan.resume or new_run_folder(plan.out, "evaluate")
    again = f"the same command with --resume {folder}"
    print_line(console, f"{folder} (if this is stopped: {again})", style="dim")
    jobs = [
        (contender, sequence, start, sequence.rate_hz or plan.fps)
        for contender in contenders
        for sequence in sequences
        for start in _starts(sequence, plan.tre, plan.sre)
    ]
    try:
        with closing(engine_for(plan.workers, plan.dask, _LONGEST_S)) as engine:
            runs, broken = _run_all(jobs, ResultStore(folder / _BOXES), console, engine)
    except KeyboardInterrupt:
        raise EvaluationInterrupted(folder) from None
    remarks += [f"skipped {name}: {why}" for name, why in broken.items()]
    kept = [one for one in [*runs, *others] if one.sequence not in broken]
    if not kept:
        raise SettingsError(f"no sequence could be measured: {'; '.join(remarks)}")
    whole = [sequence for sequence in sequences if sequence.name not in broken]
    remarks += [*_clipped(kept, whole), *_failed(kept)]
    found = Evaluation(
        folder,
        rows(kept),
        differences(kept),
        kept,
        attribute_rows(kept),
        toolkit_rows(kept, whole),
        remarks,
    )
    _write(found, whole)
    return found


def _clipped(runs: Iterable[ScoredRun], sequences: Iterable[Sequence]) -> list[str]:
    """Say of which sequences the first box reaches beyond the image."""
    initial = {sequence.name: sequence.initial for sequence in sequences}
    names = {
        one.sequence: None
        for one in runs
        if one.kind == "ope" and one.result.frame_s and one.result.boxes[0] != initial[one.sequence]
    }
    said = "the first box lies partly outside the image, and trackers started from the part inside"
    return [f"{', '.join(names)}: {said}"] if names else []


def _failed(runs: Iterable[ScoredRun]) -> list[str]:
    """Say which trackers' parts of other packages failed, and on which sequences."""
    names: dict[tuple[str, str], dict[str, None]] = {}
    for one in runs:
        for failure in one.result.failures:
            names.setdefault((one.tracker, failure), {})[one.sequence] = None
    return [f"{tracker} on {', '.join(on)}: {said}" for (tracker, said), on in names.items()]


def _can_be_made(contender: Contender, remarks: list[str]) -> bool:
    """Return whether a contender can run, or remark which plug-in is left out.

    Raises:
        ModelError: a network is missing: that is said before hours of work.
    """
    try:
        contender.make()
    except PluginError as error:
        remarks.append(f"{contender.name} is left out: {error}")
        return False
    return True


def _sequences(folders: Iterable[Path]) -> tuple[list[Sequence], list[str]]:
    found: dict[str, Sequence] = {}
    remarks: list[str] = []
    for folder in folders:
        sequences, said = load_dataset(folder)
        remarks += said
        for sequence in sequences:
            if not any(sequence.truth[1:]):
                remarks.append(f"skipped {sequence.name}: no box after the first frame")
            elif sequence.name in found:
                remarks.append(f"skipped a second {sequence.name} in {folder}: names must differ")
            else:
                found[sequence.name] = sequence
    if not found:
        raise DatasetError(f"no sequence can be used: {'; '.join(remarks)}")
    return list(found.values()), remarks


def _starts(sequence: Sequence, tre: int, sre: bool) -> list[RunStart]:
    starts = [RunStart("ope", 0, 0, sequence.initial)]
    frames = temporal_starts(sequence.truth, tre) if tre else []
    for number, frame in enumerate(frames):
        box = sequence.truth[frame]
        if box is not None:
            starts.append(RunStart("tre", number, frame, box))
    if sre:
        boxes = spatial_starts(sequence.initial)
        starts += [RunStart("sre", number, 0, box) for number, box in enumerate(boxes)]
    return starts


_Job = tuple[Contender, Sequence, RunStart, float]


def _run_all(
    jobs: list[_Job], store: ResultStore, console: Console, engine: Engine
) -> tuple[list[ScoredRun], dict[str, str]]:
    """Return the runs, and why a sequence broke off: it could not be read or started from."""
    results = {number: store.load(*job) for number, job in enumerate(jobs)}
    missing = [number for number, result in results.items() if result is None]
    broken: dict[str, str] = {}
    left = ((one, jobs[one]) for one in missing if jobs[one][1].name not in broken)
    attempt = partial(_attempt, threads=cv2.getNumThreads())
    with job_progress(console, "evaluating", len(jobs), len(jobs) - len(missing)) as count_one:
        for done in engine.run(attempt, left):
            number, job = done.job
            outcome = done.failure or done.result
            if isinstance(outcome, str):
                broken[job[1].name] = outcome
            else:
                store.save(*job, outcome)
                results[number] = outcome
            count_one()
    flown = zip(jobs, results.values(), strict=True)
    runs = [scored(job[0].name, *job[1:], result) for job, result in flown if result is not None]
    return runs, broken


def _attempt(numbered: tuple[int, _Job], threads: int) -> EvaluationResult | str:
    """Run a tracker over a sequence; return why if it cannot be read or started from."""
    cv2.setNumThreads(threads)
    try:
        return run(*numbered[1], MonotonicClock())
    except (OSError, DatasetError) as error:
        return str(error)


def _others(
    boxes: Iterable[str],
    fps: float,
    sequences: list[Sequence],
    remarks: list[str],
    taken: set[str],
) -> list[ScoredRun]:
    """Score the boxes of other programs; a sequence that they lack is said and left out.

    Raises:
        DatasetError: a folder's boxes do not fit, or its name is `taken`, by a tracker or another.
    """
    runs = []
    for text in boxes:
        name, equals, folder = text.partition("=")
        if not (name and equals and Path(folder).is_dir()):
            raise DatasetError(f"--boxes {text}: write name=folder; the folder has to exist")
        if name in taken:
            raise DatasetError(f"--boxes {text}: there is a tracker {name} already")
        taken.add(name)
        for sequence in sequences:
            path = Path(folder, f"{sequence.name}.txt")
            if not path.is_file():  # GOT-10k's toolkit writes this one
                path = Path(folder, sequence.name, f"{sequence.name}_001.txt")
            if not path.is_file():
                remarks.append(f"{name}: no {sequence.name}.txt in {folder}; left out of its means")
                continue
            result = EvaluationResult(tuple(read_boxes(path)))
            if len(result.boxes) != len(sequence.truth):
                raise DatasetError(
                    f"{path}: {len(result.boxes)} lines for {len(sequence.truth)} frames"
                )
            start = RunStart("ope", 0, 0, sequence.initial)
            runs.append(scored(name, sequence, start, sequence.rate_hz or fps, result))
    return runs


def _write(found: Evaluation, sequences: list[Sequence]) -> None:
    table, figures, page = (found.folder / name for name in _FILES)
    write_csv(table, found.runs)
    write_json(figures, found)
    write_toolkit_files(found.folder, found.runs)
    write_whole(page, render(found, sequences))
