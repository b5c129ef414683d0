"""The tables of an evaluation."""

from __future__ import annotations

from collections.abc import Sequence

from follower.evaluate.outputs import (
    ATTRIBUTE_HEAD,
    attribute_figures,
    honesty_texts,
    stateless,
    texts,
)
from follower.evaluate.summary import AttributeRow, Row, Scored
from follower.report import html
from follower.report.html import Cell, Html

_MEANS = (
    "tracker",
    "start",
    "AUC",
    "success at 0.5",
    "precision at 20 px",
    "normalised precision",
    "frames a second",
    "processor ms a frame",
)
_HONESTY = (
    "tracker",
    "start",
    "TRACKING at IoU 0",
    "TRACKING, absent",
    "right, doubted",
    "returns",
    "found after",
    "under 0.5 s",
    "losses",
    "found after",
    "under 0.5 s",
)


def means_table(rows: Sequence[Row]) -> str:
    """Return the means, best first."""
    numbers = range(2, len(_MEANS))
    return html.table(_MEANS, [(row.tracker, row.kind, *texts(row)) for row in rows], numbers)


def honesty_table(rows: Sequence[Row]) -> str:
    """Return what the states are worth, and who has none."""
    told = [(row.tracker, row.kind, *honesty_texts(row.honesty)) for row in rows if row.honesty]
    silent = stateless(rows)
    remark = (
        "TRACKING at IoU 0: share of the frames with the target in which the tracker said TRACKING "
        "beside it. Doubted: share of the right boxes (overlap above 0.5) not called TRACKING. "
        "Returns: the target came back after an absence; losses: the tracker lost it while it was "
        "there; found after: median time in seconds until a right box is called TRACKING."
    )
    return "\n".join(
        part
        for part in (
            html.table(_HONESTY, told, range(2, len(_HONESTY))),
            html.paragraph(remark) if told else "",
            html.paragraph(f"No states are known of {', '.join(silent)}.") if silent else "",
        )
        if part
    )


def attribute_table(rows: Sequence[AttributeRow]) -> str:
    """Return the means by attribute, folded, "" without attributes."""
    lines = [
        tuple(f"{value:.3f}" if isinstance(value, float) else str(value) for value in figures)
        for figures in map(attribute_figures, rows)
    ]
    table = html.table(ATTRIBUTE_HEAD, lines, range(2, len(ATTRIBUTE_HEAD)))
    return html.folded("The same as a table", table) if lines else ""


def sequence_table(runs: Sequence[Scored], trackers: Sequence[str]) -> str:
    """Return success@0.5 of each tracker on each sequence, shaded."""
    values = {(one.sequence, one.tracker): one.score.success for one in runs}
    names = dict.fromkeys(one.sequence for one in runs)
    rows: list[list[Cell]] = [
        [name, *(_shaded(values.get((name, one))) for one in trackers)] for name in names
    ]
    upright = [f'<span class="upright">{html.text_of(one)}</span>' for one in trackers]
    head: list[Cell] = ["", *(Html(text) for text in upright)]
    return html.table(head, rows, range(1, len(head)))


def _shaded(share: float | None) -> Html:
    if share is None:
        return Html("–")
    percent = round(45 * share)
    shade = f"color-mix(in srgb, var(--green) {percent}%, transparent)"
    return Html(f'<span class="shaded" style="background: {shade}">{share:.2f}</span>')
