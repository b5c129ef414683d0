"""Runs an evaluation: every tracker on every sequence from every start."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from follower.evaluate.contender import Contender
from follower.evaluate.outputs import (
    stateless,
    terminal_tables,
    write_attributes_csv,
    write_csv,
    write_json,
)
from follower.evaluate.results import Result, ResultStore, Start, run
from follower.evaluate.summary import Scored, attribute_rows, rows, scored
from follower.print_line import print_line
from follower.report.evaluation import render
from follower.report.writer import write_whole
from follower.run_folder import new_run_folder
from follower_control.strict_yaml import SettingsError
from follower_vision.clock import MonotonicClock
from follower_vision.curves import spatial_starts, temporal_starts
from follower_vision.datasets import DatasetError, load_dataset, read_boxes
from follower_vision.ope import Sequence

_SUCCESS, _INTERRUPTED = 0, 130


class _UnreadableError(Exception):
    """A sequence's images cannot be read to the end."""


@dataclass(frozen=True, slots=True)
class EvaluateOptions:
    """What the command line was given; see `follower evaluate --help`."""

    folders: tuple[Path, ...]
    trackers: tuple[str, ...]
    detector: str = "yolox-nano"
    boxes: tuple[str, ...] = ()
    tre: int = 0
    sre: bool = False
    out: Path = Path("runs")
    resume: Path | None = None
    fps: float = 30.0
    threads: int = 1


def evaluate(options: EvaluateOptions, console: Console | None = None) -> int:
    """Run the command and return its exit code.

    Raises:
        SettingsError: a tracker or folder is not there; one line says what to do.
        ModelError: a network is missing.
        OSError: an image cannot be read or a result cannot be written.
    """
    console = console or Console()
    try:
        sequences, remarks = _sequences(options.folders)
        others = _others(options, sequences, remarks)
    except DatasetError as error:
        raise SettingsError(str(error)) from None
    contenders = _contenders(options)
    if not (contenders or others):
        raise SettingsError("nothing to measure: give --trackers a,b or --boxes name=folder")
    folder = options.resume or new_run_folder(options.out, "evaluate")
    cv2.setNumThreads(options.threads)
    try:
        runs, broken = _run_all(
            contenders, sequences, options, ResultStore(folder / "boxes"), console
        )
    except KeyboardInterrupt:
        print_line(console, f"interrupted; go on with --resume {folder}")
        return _INTERRUPTED
    remarks += [f"skipped {name}: {why}" for name, why in broken.items()]
    kept = [one for one in [*runs, *others] if one.sequence not in broken]
    if not kept:
        raise SettingsError(f"no sequence could be measured: {'; '.join(remarks)}")
    for remark in remarks:
        print_line(console, remark, style="yellow")
    whole = [sequence for sequence in sequences if sequence.name not in broken]
    _write(folder, kept, whole, remarks, console)
    return _SUCCESS


def _contenders(options: EvaluateOptions) -> list[Contender]:
    """Make each tracker once, so that what is missing is said before hours of work."""
    contenders = [Contender(name, options.detector) for name in dict.fromkeys(options.trackers)]
    if options.resume is not None and not options.resume.is_dir():
        raise SettingsError(f"--resume {options.resume}: there is no such folder")
    for contender in contenders:
        contender.make()
    return contenders


def _sequences(folders: tuple[Path, ...]) -> tuple[list[Sequence], list[str]]:
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


def _starts(sequence: Sequence, options: EvaluateOptions) -> list[Start]:
    starts = [Start("ope", 0, 0, sequence.initial)]
    frames = temporal_starts(sequence.truth, options.tre) if options.tre else []
    for number, frame in enumerate(frames):
        box = sequence.truth[frame]
        if box is not None:
            starts.append(Start("tre", number, frame, box))
    if options.sre:
        boxes = spatial_starts(sequence.initial)
        starts += [Start("sre", number, 0, box) for number, box in enumerate(boxes)]
    return starts


def _run_all(
    contenders: list[Contender],
    sequences: list[Sequence],
    options: EvaluateOptions,
    store: ResultStore,
    console: Console,
) -> tuple[list[Scored], dict[str, str]]:
    """Return the runs, and why a sequence broke off: a tracker could not read it whole."""
    jobs = [(c, s, start) for c in contenders for s in sequences for start in _starts(s, options)]
    runs: list[Scored] = []
    broken: dict[str, str] = {}
    with _progress(console) as progress:
        task = progress.add_task("evaluating", total=len(jobs))
        for contender, sequence, start in jobs:
            progress.update(task, description=f"{contender.name} {sequence.name}")
            progress.advance(task)
            rate_hz = sequence.rate_hz or options.fps
            try:
                if sequence.name not in broken:
                    result = _stored_or_run(contender, sequence, start, rate_hz, store)
                    runs.append(scored(contender.name, sequence, start, rate_hz, result))
            except _UnreadableError as error:
                broken[sequence.name] = str(error)
    return runs, broken


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
    )


def _stored_or_run(
    contender: Contender, sequence: Sequence, start: Start, rate_hz: float, store: ResultStore
) -> Result:
    """Return a run's result, from the store if it is there already.

    Raises:
        _UnreadableError: an image cannot be read.
        OSError: the result cannot be written.
    """
    result = store.load(contender, sequence, start, rate_hz)
    if result is None:
        try:
            result = run(contender, sequence, start, rate_hz, MonotonicClock())
        except OSError as error:
            raise _UnreadableError(str(error)) from None
        store.save(contender, sequence, start, rate_hz, result)
    return result


def _others(
    options: EvaluateOptions, sequences: list[Sequence], remarks: list[str]
) -> list[Scored]:
    """Score the boxes of other programs; a sequence that they lack is said and left out."""
    runs = []
    for text in options.boxes:
        name, equals, folder = text.partition("=")
        if not (name and equals and Path(folder).is_dir()):
            raise DatasetError(f"--boxes {text}: write name=folder; the folder has to exist")
        for sequence in sequences:
            path = _boxes_file(Path(folder), sequence.name)
            if path is None:
                remarks.append(f"{name}: no {sequence.name}.txt in {folder}; left out of its means")
                continue
            result = Result(tuple(read_boxes(path)))
            if len(result.boxes) != len(sequence.truth):
                raise DatasetError(
                    f"{path}: {len(result.boxes)} lines for {len(sequence.truth)} frames"
                )
            start = Start("ope", 0, 0, sequence.initial)
            runs.append(scored(name, sequence, start, sequence.rate_hz or options.fps, result))
    return runs


def _boxes_file(folder: Path, name: str) -> Path | None:
    """Return a sequence's file: NAME.txt, or NAME/NAME_001.txt as GOT-10k's toolkit writes it."""
    places = (folder / f"{name}.txt", folder / name / f"{name}_001.txt")
    return next((path for path in places if path.is_file()), None)


def _write(
    folder: Path,
    runs: list[Scored],
    sequences: list[Sequence],
    remarks: list[str],
    console: Console,
) -> None:
    means, attributes = rows(runs), attribute_rows(runs)
    files = [
        write_csv(folder / "results.csv", runs),
        write_json(folder / "results.json", means, attributes, runs, remarks),
        write_whole(folder / "report.html", render(means, attributes, runs, sequences, remarks)),
    ]
    if attributes:
        files.append(write_attributes_csv(folder / "attributes.csv", attributes))
    for table in terminal_tables(means):
        console.print(table)
    if stateless(means):
        print_line(console, f"no states: {', '.join(stateless(means))}", style="dim")
    for file in files:
        print_line(console, f"  {file}")
