"""The tables of a campaign's report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from follower.campaign.summary import Summary, share_text
from follower.report import html
from follower.report.html import Cell, Html

_MOST_WORST = 25
_VERDICTS = {
    "met": Html('<b style="color: var(--green); white-space: nowrap">met</b>'),
    "not met": Html('<b style="color: var(--red); white-space: nowrap">not met</b>'),
    "": Html(""),
}


def goals_table(summary: Summary) -> str:
    """Return each goal with what was reached."""
    rows = [
        (line.name, line.value, line.wanted if line.counts else "", _VERDICTS[line.verdict])
        for line in summary.lines
    ]
    return html.table(("Goal", "Reached", "Wanted", ""), rows)


def missed_table(summary: Summary) -> str:
    """Return how many runs missed which goal."""
    rows = [(name, share_text(count, summary.runs)) for name, count in summary.failures]
    return html.table(("Runs that missed", "Share"), rows)


def worst_table(summary: Summary, seen: Mapping[int, str]) -> str:
    """Return the worst runs, each with its command, and its video where there is one."""
    worst = summary.worst[:_MOST_WORST]
    rows = [_worst_row(row, seen.get(row["number"])) for row in worst]
    head = ("Run", "Missed", "Line of sight", "In frame", "Parameters", "")
    table = html.table(head, rows, (2, 3))
    commands = "\n".join(f"# run {row['number']}\n{row['command']}" for row in worst)
    return table + html.folded("The commands that fly them again", html.preformatted(commands))


def _worst_row(row: Mapping[str, Any], folder: str | None) -> Sequence[Cell]:
    missed = row["error"] or ", ".join(row["failures"])
    values = ", ".join(f"{name} {_short(value)}" for name, value in row["values"].items())
    link = ""
    if folder is not None:
        place = escape(folder)
        link = f'<a href="{place}/overlay.mp4">video</a> <a href="{place}/report.html">report</a>'
    return (
        str(row["number"]),
        missed,
        _number(row.get("line_of_sight_box_rms_seen_deg"), "{:.1f}°"),
        _number(row.get("in_frame_share"), "{:.1%}"),
        f"{row['scenario']}, {row['autopilot']}, {values}",
        Html(link),
    )


def _short(value: object) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _number(value: float | None, form: str) -> str:
    return "–" if value is None else form.format(value)
