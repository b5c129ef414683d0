"""Scores of runs and their means."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from follower.evaluate.results import Result, Start
from follower_vision import ope
from follower_vision.curves import OpeCurves, mean_curves, ope_curves
from follower_vision.metrics import OpeScore, mean_score, ope_score


@dataclass(frozen=True, slots=True)
class Scored:
    """One run with its figures; `frames_s` is frames a second, None if not known."""

    tracker: str
    sequence: str
    kind: str
    score: OpeScore
    curves: OpeCurves
    frames_s: float | None
    result: Result


def scored(tracker: str, sequence: ope.Sequence, start: Start, result: Result) -> Scored:
    """Score a run against the truth from its start on.

    Raises:
        ValueError: the result has another length, or no frame can be scored.
    """
    truth = sequence.truth[start.frame :]
    score, curves = ope_score(result.boxes, truth), ope_curves(result.boxes, truth)
    rate = (len(truth) - 1) / result.busy_s if result.busy_s > 0 else None
    return Scored(tracker, sequence.name, start.kind, score, curves, rate, result)


@dataclass(frozen=True, slots=True)
class Row:
    """A tracker's means over the sequences for one kind of start."""

    tracker: str
    kind: str
    score: OpeScore
    curves: OpeCurves
    frames_s: float | None


def rows(runs: Iterable[Scored]) -> list[Row]:
    """Average first over a sequence's starts, then over the sequences."""
    groups: dict[tuple[str, str], dict[str, list[Scored]]] = {}
    for one in runs:
        groups.setdefault((one.kind, one.tracker), {}).setdefault(one.sequence, []).append(one)
    return [_row(tracker, kind, list(by.values())) for (kind, tracker), by in groups.items()]


def _row(tracker: str, kind: str, sequences: Sequence[list[Scored]]) -> Row:
    score = mean_score([mean_score([one.score for one in runs]) for runs in sequences])
    curves = mean_curves([mean_curves([one.curves for one in runs]) for runs in sequences])
    timed = [one for runs in sequences for one in runs if one.frames_s]
    busy_s = sum(one.result.busy_s for one in timed)
    frames = sum(len(one.result.boxes) - 1 for one in timed)
    return Row(tracker, kind, score, curves, frames / busy_s if timed else None)
