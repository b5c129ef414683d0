"""Scores of runs and their means."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from follower.evaluate.results import Result, Start
from follower_vision import ope
from follower_vision.box import Box
from follower_vision.curves import OpeCurves, mean_curves, ope_curves
from follower_vision.honesty import Honesty, honesty, mean_honesty
from follower_vision.metrics import OpeScore, mean_score, ope_score


@dataclass(frozen=True, slots=True)
class Scored:
    """One run with its figures.

    Attributes:
        tracker: its name.
        sequence: its name.
        kind: of start.
        score: over all frames.
        curves: over all frames.
        frames_s: frames a second by the clock, None if not known.
        processor_ms: processor time a frame in milliseconds, None if not known.
        honesty: None for a tracker without states.
        attributes: score over the frames that have each.
        result: what the tracker answered.
    """

    tracker: str
    sequence: str
    kind: str
    score: OpeScore
    curves: OpeCurves
    frames_s: float | None
    processor_ms: float | None
    honesty: Honesty | None
    attributes: Mapping[str, OpeScore]
    result: Result


def scored(
    tracker: str, sequence: ope.Sequence, start: Start, rate_hz: float, result: Result
) -> Scored:
    """Score a run against the truth from its start on.

    Raises:
        ValueError: the result has another length, or no frame can be scored.
    """
    truth = sequence.truth[start.frame :]
    boxes, states, frames = result.boxes, result.states, len(truth) - 1
    return Scored(
        tracker,
        sequence.name,
        start.kind,
        ope_score(boxes, truth),
        ope_curves(boxes, truth),
        frames / result.busy_s if result.busy_s > 0 else None,
        1000 * result.processor_s / frames if result.processor_s > 0 else None,
        None if states is None else honesty(boxes, states, truth, 1 / rate_hz),
        dict(_attribute_scores(boxes, sequence, start.frame)),
        result,
    )


def _attribute_scores(
    boxes: Sequence[Box | None], sequence: ope.Sequence, first: int
) -> Iterable[tuple[str, OpeScore]]:
    for name, flags in sequence.attributes.items():
        pairs = zip(sequence.truth[first:], flags[first:], strict=True)
        truth = [box if holds else None for box, holds in pairs]
        if any(truth[1:]):
            yield name, ope_score(boxes, truth)


@dataclass(frozen=True, slots=True)
class Row:
    """A tracker's means over the sequences for one kind of start."""

    tracker: str
    kind: str
    score: OpeScore
    curves: OpeCurves
    frames_s: float | None
    processor_ms: float | None
    honesty: Honesty | None


def rows(runs: Iterable[Scored]) -> list[Row]:
    """Average first over a sequence's starts, then over the sequences; best AUC first."""
    groups: dict[tuple[str, str], dict[str, list[Scored]]] = {}
    for one in runs:
        groups.setdefault((one.kind, one.tracker), {}).setdefault(one.sequence, []).append(one)
    means = [_row(tracker, kind, list(by.values())) for (kind, tracker), by in groups.items()]
    kinds = list(dict.fromkeys(row.kind for row in means))
    return sorted(means, key=lambda row: (kinds.index(row.kind), -row.score.auc))


def _row(tracker: str, kind: str, sequences: Sequence[list[Scored]]) -> Row:
    every = [one for runs in sequences for one in runs]
    score = mean_score([mean_score([one.score for one in runs]) for runs in sequences])
    curves = mean_curves([mean_curves([one.curves for one in runs]) for runs in sequences])
    said = [one.honesty for one in every if one.honesty is not None]
    return Row(
        tracker,
        kind,
        score,
        curves,
        _frames_s(every),
        _processor_ms(every),
        mean_honesty(said) if said else None,
    )


def _frames_s(runs: Sequence[Scored]) -> float | None:
    timed = [one.result for one in runs if one.frames_s]
    frames = sum(len(result.boxes) - 1 for result in timed)
    return frames / sum(result.busy_s for result in timed) if timed else None


def _processor_ms(runs: Sequence[Scored]) -> float | None:
    timed = [one.result for one in runs if one.processor_ms]
    frames = sum(len(result.boxes) - 1 for result in timed)
    return 1000 * sum(result.processor_s for result in timed) / frames if timed else None


@dataclass(frozen=True, slots=True)
class AttributeRow:
    """A tracker's means over the frames with an attribute, each sequence with the same weight."""

    attribute: str
    tracker: str
    sequences: int
    score: OpeScore


def attribute_rows(runs: Iterable[Scored]) -> list[AttributeRow]:
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
