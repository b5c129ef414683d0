"""Scores of runs, and what a tracker is worth over many of them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from follower.apps.evaluate.contender import EvaluationResult, RunStart
from follower_vision.evaluation import one_pass
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
