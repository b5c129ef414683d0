"""Scores of runs, and what a tracker is worth over many of them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from follower.apps.evaluate.contender import EvaluationResult, RunStart
from follower_vision.evaluation import one_pass
from follower_vision.evaluation.intervals import (
    PairedDifference,
    Values,
    interval,
    paired_difference,
)
from follower_vision.evaluation.metrics import (
    OpeCurves,
    OpeScore,
    StateAccuracy,
    mean_curves,
    mean_score,
    mean_state_accuracy,
    ope_curves,
    ope_score,
    state_accuracy,
)
from follower_vision.evaluation.toolkits import ToolkitScore, mean_toolkit_score, toolkit_score
from follower_vision.geometry.box import Box

COMPARED = ("auc", "success", "precision")
"""Figures of `OpeScore` that get an interval and are compared; both need two sequences."""
_FEWEST = 2


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
class MeanRow(ResultRow):
    """A tracker's means over the sequences, each with the same weight.

    Attributes:
        intervals: the 95 % bootstrap interval of `auc`, `success` and `precision` over the
            sequences; empty with a single one.
    """

    intervals: Mapping[str, tuple[float, float]]


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


Groups = dict[tuple[str, str], dict[str, list[ScoredRun]]]


def _grouped(runs: Iterable[ScoredRun]) -> Groups:
    """Return the runs by kind of start and tracker, and by sequence in these."""
    groups: Groups = {}
    for one in runs:
        groups.setdefault((one.kind, one.tracker), {}).setdefault(one.sequence, []).append(one)
    return groups


def rows(runs: Iterable[ScoredRun]) -> list[MeanRow]:
    """Average first over a sequence's starts, then over the sequences; best AUC first."""
    groups = _grouped(runs)
    means = [_row(tracker, kind, list(by.values())) for (kind, tracker), by in groups.items()]
    kinds = list(dict.fromkeys(row.kind for row in means))
    return sorted(means, key=lambda row: (kinds.index(row.kind), -row.score.auc))


def _row(tracker: str, kind: str, sequences: Sequence[list[ScoredRun]]) -> MeanRow:
    every = [one for runs in sequences for one in runs]
    scores = [_mean_of(runs) for runs in sequences]
    curves = mean_curves([mean_curves([one.curves for one in runs]) for runs in sequences])
    states = [mean_state_accuracy(known) for runs in sequences if (known := _states_of(runs))]
    return MeanRow(
        tracker,
        kind,
        mean_score(scores),
        curves,
        *_speed([one.result for one in every]),
        mean_state_accuracy(states) if states else None,
        {name: interval(_values(scores, name)) for name in COMPARED}
        if len(scores) >= _FEWEST
        else {},
    )


def _mean_of(runs: Sequence[ScoredRun]) -> OpeScore:
    return mean_score([one.score for one in runs])


def _states_of(runs: Sequence[ScoredRun]) -> list[StateAccuracy]:
    return [one.states for one in runs if one.states is not None]


def _values(scores: Sequence[OpeScore], name: str) -> Values:
    return np.array([getattr(score, name) for score in scores], float)


@dataclass(frozen=True, slots=True)
class Difference:
    """How much more a tracker has of a figure than another, on the sequences that both ran.

    Attributes:
        tracker: its name.
        reference: the other one's: that of the first named.
        kind: of start.
        figure: `auc`, `success` or `precision`.
        sequences: how many both ran.
        paired: the mean difference, its 95 % interval, and p of the paired test.
    """

    tracker: str
    reference: str
    kind: str
    figure: str
    sequences: int
    paired: PairedDifference


def differences(runs: Sequence[ScoredRun]) -> list[Difference]:
    """Compare each tracker with the first one; nothing where they share a single sequence."""
    groups, found = _grouped(runs), []
    for (kind, tracker), by_sequence in groups.items():
        reference = runs[0].tracker
        others = groups.get((kind, reference), {})
        shared = [name for name in by_sequence if name in others]
        if tracker == reference or len(shared) < _FEWEST:
            continue
        scores = [_mean_of(by_sequence[name]) for name in shared]
        other_scores = [_mean_of(others[name]) for name in shared]
        for figure in COMPARED:
            paired = paired_difference(_values(scores, figure), _values(other_scores, figure))
            found.append(Difference(tracker, reference, kind, figure, len(shared), paired))
    return found


@dataclass(frozen=True, slots=True)
class ToolkitRow:
    """A tracker's one-pass figures by the toolkits' protocols."""

    tracker: str
    score: ToolkitScore


def toolkit_rows(
    runs: Iterable[ScoredRun], sequences: Sequence[one_pass.Sequence]
) -> list[ToolkitRow]:
    """Score the one-pass runs as got10k-toolkit and vot-toolkit do; best OTB success first.

    Raises:
        OSError: the first image of a sequence cannot be read.
    """
    sizes: dict[str, tuple[int, int]] = {}
    for sequence in sequences:
        height, width = one_pass.read_image(sequence.images[0]).shape[:2]
        sizes[sequence.name] = (width, height)
    named = {sequence.name: sequence for sequence in sequences}
    scores: dict[str, list[ToolkitScore]] = {}
    for one in runs:
        if one.kind == "ope":
            sequence = named[one.sequence]
            size, boxes = sizes[one.sequence], one.result.boxes
            score = toolkit_score(boxes, sequence.truth, size, sequence.rectangles)
            scores.setdefault(one.tracker, []).append(score)
    found = [ToolkitRow(tracker, mean_toolkit_score(each)) for tracker, each in scores.items()]
    return sorted(found, key=lambda row: -row.score.otb_success)


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


@dataclass(frozen=True, slots=True)
class Evaluation:
    """What trackers are worth on data sets.

    Attributes:
        folder: holds report.html, results.csv, results.json, the boxes, and these once more as
            got10k-toolkit and vot-toolkit read them.
        means: each tracker's means over the sequences, best first: `score.auc`,
            `score.precision` and others from 0 to 1 with their `intervals`, `frames_s` in frames
            a second.
        differences: each tracker compared with the first named, figure by figure.
        runs: the figures of each run.
        attributes: the means by attribute.
        toolkits: the means by the toolkits' protocols.
        remarks: what was left out, in sentences.

    Examples:
        >>> import follower
        >>> found = follower.evaluate("otb", ["correlation", "identity"])
        >>> for row in found.means:
        ...     print(row.tracker, row.score.auc > 0.5)
        correlation True
        identity False
    """

    folder: Path
    means: list[MeanRow]
    differences: list[Difference]
    runs: list[ScoredRun]
    attributes: list[AttributeRow]
    toolkits: list[ToolkitRow]
    remarks: list[str]
