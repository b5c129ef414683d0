"""Writes results.csv, attributes.csv, results.json and the tables in the terminal."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

from rich.table import Table

from follower.evaluate.summary import AttributeRow, Row, Scored
from follower.report.writer import write_whole
from follower_vision.honesty import Honesty, median_s, share_soon

HEAD = (
    "tracker",
    "start",
    "auc",
    "success@0.5",
    "precision@20",
    "norm. prec.",
    "fps",
    "cpu ms",
)
HONESTY_HEAD = (
    "tracking at iou 0",
    "tracking while absent",
    "right but doubted",
    "returns",
    "return median s",
    "return under 0.5 s",
    "losses",
    "loss median s",
    "loss under 0.5 s",
)
ATTRIBUTE_HEAD = ("attribute", "tracker", "sequences", *HEAD[2:5], "frames")
NEVER = "never"
_SHORT = ("AUC", "S@0.5", "P@20", "NP", "fps", "CPU ms")
_SHORT_HONESTY = (
    "TRACKING at IoU 0", "while absent", "doubted",
    "returns", "median s", "< 0.5 s", "losses", "median s", "< 0.5 s",
)  # fmt: skip

Figure = float | int | str | None


def figures(one: Row | Scored) -> list[float | None]:
    """Return AUC, success, precision, normalised precision, frames a second, processor ms."""
    score, normalised = one.score, one.curves.normalised_precision
    shares = [score.auc, score.success, score.precision, normalised]
    return [*shares, one.frames_s, one.processor_ms]


def texts(one: Row | Scored) -> list[str]:
    """Return the figures as shown."""
    *shares, rate, milliseconds = figures(one)
    shown = [f"{share:.3f}" for share in shares]
    return [
        *shown,
        "" if rate is None else f"{rate:.0f}",
        "" if milliseconds is None else f"{milliseconds:.1f}",
    ]


def honesty_figures(said: Honesty | None) -> list[Figure]:
    """Return the figures of HONESTY_HEAD; None where there is nothing to tell, "never" for ever."""
    if said is None:
        return [None] * len(HONESTY_HEAD)
    return [
        said.false_tracking,
        said.absent_tracking,
        said.doubted,
        *_delays(said.returns_s),
        *_delays(said.losses_s),
    ]


def _delays(times_s: Sequence[float]) -> list[Figure]:
    median = median_s(times_s)
    shown = NEVER if median is not None and math.isinf(median) else median
    return [len(times_s), shown, share_soon(times_s)]


def honesty_texts(said: Honesty | None) -> list[str]:
    """Return the figures as shown."""
    values = honesty_figures(said)
    shares = (0, 1, 2, 5, 8)
    return [_text(value, index in shares) for index, value in enumerate(values)]


def _text(value: Figure, share: bool) -> str:
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{100 * value:.1f} %" if share else f"{value:.2f}"
    return str(value)


def stateless(rows: Sequence[Row]) -> list[str]:
    """Return the names of the trackers that know no states."""
    return list(dict.fromkeys(row.tracker for row in rows if row.honesty is None))


def terminal_tables(rows: Sequence[Row]) -> Iterable[Table]:
    """Yield the means, and what the states are worth where a tracker has some."""
    yield _table(_SHORT, [(row, texts(row)) for row in rows])
    said = [(row, honesty_texts(row.honesty)) for row in rows if row.honesty]
    if said:
        yield _table(_SHORT_HONESTY, said)


def _table(head: Sequence[str], lines: Iterable[tuple[Row, Sequence[str]]]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    for number, name in enumerate((*HEAD[:2], *head)):
        table.add_column(name, justify="left" if number < 2 else "right", no_wrap=number < 2)
    for row, cells in lines:
        table.add_row(row.tracker, row.kind, *cells)
    return table


def write_csv(path: Path, runs: Sequence[Scored]) -> Path:
    """Write a line a run.

    Raises:
        OSError: it cannot be written.
    """
    head = (HEAD[0], "sequence", *HEAD[1:], "frames", *HONESTY_HEAD)
    lines = [
        (one.tracker, one.sequence, one.kind, *figures(one), one.score.frames,
         *honesty_figures(one.honesty))
        for one in runs
    ]  # fmt: skip
    return _write_csv(path, head, lines)


def write_attributes_csv(path: Path, rows: Sequence[AttributeRow]) -> Path:
    """Write a line for each attribute and tracker.

    Raises:
        OSError: it cannot be written.
    """
    return _write_csv(path, ATTRIBUTE_HEAD, [attribute_figures(row) for row in rows])


def attribute_figures(row: AttributeRow) -> tuple[Figure, ...]:
    """Return the figures of ATTRIBUTE_HEAD."""
    score = row.score
    shares = (score.auc, score.success, score.precision)
    return (row.attribute, row.tracker, row.sequences, *shares, score.frames)


def _write_csv(path: Path, head: Sequence[str], lines: Iterable[Sequence[Figure]]) -> Path:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(lines)
    return write_whole(path, text.getvalue())


def write_json(
    path: Path,
    rows: Sequence[Row],
    attributes: Sequence[AttributeRow],
    runs: Sequence[Scored],
    remarks: Sequence[str],
) -> Path:
    """Write the means with their curves, the means by attribute, and each run's figures.

    Raises:
        OSError: it cannot be written.
    """
    stored = {
        "means": [{**_entry(row), "curves": asdict(row.curves)} for row in rows],
        "attributes": [
            dict(zip(ATTRIBUTE_HEAD, attribute_figures(row), strict=True)) for row in attributes
        ],
        "runs": [{"sequence": one.sequence, **_entry(one)} for one in runs],
        "remarks": list(remarks),
    }
    return write_whole(path, json.dumps(stored, indent=1, allow_nan=False))


def _entry(one: Row | Scored) -> dict[str, object]:
    entry = dict(zip(HEAD, (one.tracker, one.kind, *figures(one)), strict=True))
    said = dict(zip(HONESTY_HEAD, honesty_figures(one.honesty), strict=True))
    return {**entry, "states": None if one.honesty is None else said}
