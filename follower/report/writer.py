"""Writes a run's report and score; what is there is whole, or it is not there."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from follower.flightlog import FlightLog
from follower.report.flight import Flight
from follower.report.meta import ReportMeta
from follower.report.page import render
from follower_sim.criteria import Criteria, verdict
from follower_sim.score import PursuitGoal, PursuitScore
from follower_sim.truth_sample import TruthSample

REPORT = "report.html"
SCORE = "score.json"


def write_report(
    folder: Path,
    log: FlightLog,
    meta: ReportMeta,
    *,
    truth: Sequence[TruthSample] = (),
    goal: PursuitGoal | None = None,
    score: PursuitScore | None = None,
    criteria: Criteria | None = None,
    target_size_m: float | None = None,
) -> Path:
    """Write `report.html` and return its path. Works with any log, an empty one too.

    Args:
        folder: exists already.
        log: the flight.
        meta: what was run.
        truth: the simulator's samples; without them nothing true is drawn.
        goal: the wanted direction and distance, for the plots.
        score: None where there is no truth.
        criteria: what the score is held against, by default the usual ones.
        target_size_m: the servo's `target_size_m`; with it the range seen by the box is drawn.

    Raises:
        OSError: it cannot be written.
    """
    flight = Flight.of(log, truth, goal, target_size_m, score)
    page = render(flight, meta, score, criteria or Criteria())
    return write_whole(folder / REPORT, page)


def write_score(
    folder: Path,
    score: PursuitScore,
    criteria: Criteria | None = None,
    run: Mapping[str, object] | None = None,
) -> Path:
    """Write `score.json`: whether it passed, the failures, the figures and the criteria.

    Args:
        folder: exists already.
        score: figures that could not be measured are written as null.
        criteria: what the score is held against.
        run: what was run, e.g. scenario, autopilot and seed.

    Raises:
        OSError: it cannot be written.
    """
    held_against = criteria or Criteria()
    failures = verdict(score, held_against)
    content = {
        "passed": not failures,
        "failures": failures,
        "run": dict(run or {}),
        "score": score.to_dict(),
        "criteria": asdict(held_against),
    }
    return write_whole(folder / SCORE, json.dumps(content, indent=2, allow_nan=False) + "\n")


def write_whole(path: Path, text: str) -> Path:
    """Write a file under another name first, so that nobody ever sees half of it."""
    return write_whole_bytes(path, text.encode("utf-8"))


def write_whole_bytes(path: Path, content: bytes) -> Path:
    """Do the same with bytes."""
    draft = path.with_name(f".{path.name}.part")
    try:
        draft.write_bytes(content)
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
    return path
