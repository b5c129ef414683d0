"""Writes results.csv, results.json and the table in the terminal."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from rich.table import Table

from follower.evaluate.summary import Row, Scored
from follower.report.writer import write_whole

HEAD = ("tracker", "start", "auc", "success@0.5", "precision@20", "norm. prec.", "fps")


def figures(one: Row | Scored) -> list[float | None]:
    """Return AUC, success, precision, normalised precision and frames a second."""
    score = one.score
    return [
        score.auc,
        score.success,
        score.precision,
        one.curves.normalised_precision,
        one.frames_s,
    ]


def texts(one: Row | Scored) -> list[str]:
    """Return the figures as shown."""
    *shares, rate = figures(one)
    return [*(f"{share:.3f}" for share in shares), "" if rate is None else f"{rate:.0f}"]


def terminal_table(rows: Sequence[Row]) -> Table:
    """Return the means as a table: AUC, success, precision, normalised precision, speed."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    for number, name in enumerate((*HEAD[:2], "AUC", "S@0.5", "P@20", "NP", "fps")):
        table.add_column(name, justify="left" if number < 2 else "right", no_wrap=True)
    for row in rows:
        table.add_row(row.tracker, row.kind, *texts(row))
    return table


def write_csv(path: Path, runs: Sequence[Scored]) -> Path:
    """Write a line a run.

    Raises:
        OSError: it cannot be written.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow((HEAD[0], "sequence", *HEAD[1:], "frames"))
    for one in runs:
        writer.writerow((one.tracker, one.sequence, one.kind, *figures(one), one.score.frames))
    return write_whole(path, text.getvalue())


def write_json(
    path: Path, rows: Sequence[Row], runs: Sequence[Scored], remarks: Sequence[str]
) -> Path:
    """Write the means with their curves, and each run's figures.

    Raises:
        OSError: it cannot be written.
    """
    means = [dict(zip(HEAD, (r.tracker, r.kind, *figures(r)), strict=True)) for r in rows]
    curves = [asdict(row.curves) for row in rows]
    each = [
        {"sequence": s.sequence, **dict(zip(HEAD, (s.tracker, s.kind, *figures(s)), strict=True))}
        for s in runs
    ]
    joined = [{**mean, "curves": curve} for mean, curve in zip(means, curves, strict=True)]
    stored = {"means": joined, "runs": each, "remarks": list(remarks)}
    return write_whole(path, json.dumps(stored, indent=1))
