"""Writes results.csv, results.json and the tables in the terminal."""

import csv
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.table import Table

from follower.apps.evaluate.contender import EvaluationResult, RunStart
from follower_vision.disk import write_whole
from follower_vision.evaluation import one_pass
from follower_vision.evaluation.metrics import (
    OpeCurves,
    OpeScore,
    StateAccuracy,
    mean_curves,
    mean_score,
    mean_state_accuracy,
    median_s,
    ope_curves,
    ope_score,
    share_soon,
    state_accuracy,
)
from follower_vision.geometry.box import Box


@dataclass(frozen=True, slots=True)
class ResultRow:
    """A tracker's figures for one kind of start: of a run, or the means over the sequences.

    Attributes:
        tracker: its name.
        kind: of start.
        score: over all frames.
        curves: over all frames.
        frames_s: frames a second by the clock, None if not known.
        processor_ms: processor time a frame in milliseconds, None if not known.
        states: how accurate they are; None for a tracker without states.
    """

    tracker: str
    kind: str
    score: OpeScore
    curves: OpeCurves
    frames_s: float | None
    processor_ms: float | None
    states: StateAccuracy | None


@dataclass(frozen=True, slots=True)
class ScoredRun(ResultRow):
    """One run with its figures.

    Attributes:
        sequence: its name.
        attributes: score over the frames that have each.
        result: what the tracker answered.
    """

    sequence: str
    attributes: Mapping[str, OpeScore]
    result: EvaluationResult


def scored(
    tracker: str,
    sequence: one_pass.Sequence,
    start: RunStart,
    rate_hz: float,
    result: EvaluationResult,
) -> ScoredRun:
    """Score a run against the truth from its start on.

    Raises:
        ValueError: the result has another length, or no frame can be scored.
    """
    truth = sequence.truth[start.frame :]
    boxes, states = result.boxes, result.states
    return ScoredRun(
        tracker,
        start.kind,
        ope_score(boxes, truth),
        ope_curves(boxes, truth),
        *_speed([result]),
        None if states is None else state_accuracy(boxes, states, truth, 1 / rate_hz),
        sequence.name,
        dict(_attribute_scores(boxes, sequence, start.frame)),
        result,
    )


def _speed(results: Sequence[EvaluationResult]) -> tuple[float | None, float | None]:
    """Return frames a second by the clock, and processor time a frame in milliseconds."""
    frames = sum(len(result.boxes) - 1 for result in results if result.busy_s > 0)
    busy_s = sum(result.busy_s for result in results)
    processor_s = sum(result.processor_s for result in results)
    if not frames:
        return None, None
    return frames / busy_s, 1000 * processor_s / frames


def _attribute_scores(
    boxes: Sequence[Box | None], sequence: one_pass.Sequence, first: int
) -> Iterable[tuple[str, OpeScore]]:
    for name, flags in sequence.attributes.items():
        pairs = zip(sequence.truth[first:], flags[first:], strict=True)
        truth = [box if holds else None for box, holds in pairs]
        if any(truth[1:]):
            yield name, ope_score(boxes, truth)


def rows(runs: Iterable[ScoredRun]) -> list[ResultRow]:
    """Average first over a sequence's starts, then over the sequences; best AUC first."""
    groups: dict[tuple[str, str], dict[str, list[ScoredRun]]] = {}
    for one in runs:
        groups.setdefault((one.kind, one.tracker), {}).setdefault(one.sequence, []).append(one)
    means = [_row(tracker, kind, list(by.values())) for (kind, tracker), by in groups.items()]
    kinds = list(dict.fromkeys(row.kind for row in means))
    return sorted(means, key=lambda row: (kinds.index(row.kind), -row.score.auc))


def _row(tracker: str, kind: str, sequences: Sequence[list[ScoredRun]]) -> ResultRow:
    every = [one for runs in sequences for one in runs]
    score = mean_score([mean_score([one.score for one in runs]) for runs in sequences])
    curves = mean_curves([mean_curves([one.curves for one in runs]) for runs in sequences])
    states = [one.states for one in every if one.states is not None]
    return ResultRow(
        tracker,
        kind,
        score,
        curves,
        *_speed([one.result for one in every]),
        mean_state_accuracy(states) if states else None,
    )


@dataclass(frozen=True, slots=True)
class AttributeRow:
    """A tracker's means over the frames with an attribute, each sequence with the same weight."""

    attribute: str
    tracker: str
    sequences: int
    score: OpeScore


def attribute_rows(runs: Iterable[ScoredRun]) -> list[AttributeRow]:
    """Average the one-pass runs by attribute; in order of attribute, then best AUC first."""
    groups: dict[tuple[str, str], list[OpeScore]] = {}
    for one in runs:
        for attribute, score in one.attributes.items() if one.kind == "ope" else ():
            groups.setdefault((attribute, one.tracker), []).append(score)
    found = [
        AttributeRow(attribute, tracker, len(scores), mean_score(scores))
        for (attribute, tracker), scores in groups.items()
    ]
    return sorted(found, key=lambda row: (row.attribute, -row.score.auc))


HEAD = ("tracker", "start", "auc", "success@0.5", "precision@20", "norm. prec.", "fps", "cpu ms")
STATES_HEAD = (
    "tracking at iou 0", "tracking while absent", "right but doubted",
    "returns", "return median s", "return under 0.5 s",
    "losses", "loss median s", "loss under 0.5 s",
)  # fmt: skip
NEVER = "never"
_SHORT = ("AUC", "S@0.5", "P@20", "NP", "fps", "CPU ms")
_SHORT_STATES = (
    "TRACKING at IoU 0", "while absent", "doubted",
    "returns", "median s", "< 0.5 s", "losses", "median s", "< 0.5 s",
)  # fmt: skip

Figure = float | int | str | None


def figures(one: ResultRow | ScoredRun) -> list[float | None]:
    """Return AUC, success, precision, normalised precision, frames a second, processor ms."""
    score, normalised = one.score, one.curves.normalised_precision
    shares = (score.auc, score.success, score.precision, normalised)
    return [*shares, one.frames_s, one.processor_ms]


def texts(one: ResultRow | ScoredRun) -> list[str]:
    """Return the figures as shown."""
    *shares, rate, milliseconds = figures(one)
    shown = [f"{share:.3f}" for share in shares]
    return [
        *shown,
        "" if rate is None else f"{rate:.0f}",
        "" if milliseconds is None else f"{milliseconds:.1f}",
    ]


def states_figures(states: StateAccuracy | None) -> list[Figure]:
    """Return the figures of STATES_HEAD; None where nothing is known, "never" for ever."""
    if states is None:
        return [None] * len(STATES_HEAD)
    shares = states.false_tracking, states.absent_tracking, states.doubted
    return [*shares, *_delays(states.returns_s), *_delays(states.losses_s)]


def _delays(times_s: Sequence[float]) -> list[Figure]:
    median = median_s(times_s)
    shown = NEVER if median is not None and math.isinf(median) else median
    return [len(times_s), shown, share_soon(times_s)]


def states_texts(states: StateAccuracy | None) -> list[str]:
    """Return the figures as shown."""
    values = states_figures(states)
    shares = (0, 1, 2, 5, 8)
    return [_text(value, index in shares) for index, value in enumerate(values)]


def _text(value: Figure, share: bool) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{100 * value:.1f} %" if share else f"{value:.2f}"
    return str(value)


def stateless(rows: Sequence[ResultRow]) -> list[str]:
    """Return the names of the trackers that know no states."""
    return list(dict.fromkeys(row.tracker for row in rows if row.states is None))


def terminal_tables(rows: Sequence[ResultRow]) -> Iterable[Table]:
    """Yield the means, and what the states are worth where a tracker has some."""
    yield _table(_SHORT, [(row, texts(row)) for row in rows])
    said = [(row, states_texts(row.states)) for row in rows if row.states]
    if said:
        yield _table(_SHORT_STATES, said)


def _table(head: Sequence[str], lines: Iterable[tuple[ResultRow, Sequence[str]]]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    for number, name in enumerate((*HEAD[:2], *head)):
        table.add_column(name, justify="left" if number < 2 else "right", no_wrap=number < 2)
    for row, cells in lines:
        table.add_row(row.tracker, row.kind, *cells)
    return table


def write_csv(path: Path, runs: Sequence[ScoredRun]) -> Path:
    """Write a line a run.

    Raises:
        OSError: it cannot be written.
    """
    head = (HEAD[0], "sequence", *HEAD[1:], "frames", *STATES_HEAD)
    lines = [
        (one.tracker, one.sequence, one.kind, *figures(one), one.score.frames,
         *states_figures(one.states))
        for one in runs
    ]  # fmt: skip
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(lines)
    return write_whole(path, text.getvalue())


def write_json(
    path: Path,
    rows: Sequence[ResultRow],
    attributes: Sequence[AttributeRow],
    runs: Sequence[ScoredRun],
    remarks: Sequence[str],
) -> Path:
    """Write the means with their curves, the means by attribute, and each run's figures.

    Raises:
        OSError: it cannot be written.
    """
    stored = {
        "means": [{**_entry(row), "curves": asdict(row.curves)} for row in rows],
        "attributes": [_attribute_entry(row) for row in attributes],
        "runs": [{"sequence": one.sequence, **_entry(one)} for one in runs],
        "remarks": list(remarks),
    }
    return write_whole(path, json.dumps(stored, indent=1, allow_nan=False))


def _attribute_entry(row: AttributeRow) -> dict[str, object]:
    score = row.score
    shares = zip(HEAD[2:5], (score.auc, score.success, score.precision), strict=True)
    names = {"attribute": row.attribute, "tracker": row.tracker, "sequences": row.sequences}
    return {**names, **dict(shares), "frames": score.frames}


def _entry(one: ResultRow | ScoredRun) -> dict[str, object]:
    entry = dict(zip(HEAD, (one.tracker, one.kind, *figures(one)), strict=True))
    said = dict(zip(STATES_HEAD, states_figures(one.states), strict=True))
    return {**entry, "states": None if one.states is None else said}
