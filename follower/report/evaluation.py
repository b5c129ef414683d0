"""The report of an evaluation: one HTML file that needs no network."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import resources
from string import Template

from follower.evaluate.summary import AttributeRow, Row, Scored
from follower.report import evaluation_tables as tables
from follower.report import html, style
from follower.report.evaluation_pictures import pictures
from follower.report.evaluation_plots import attribute_plot, curve_plots
from follower.report.tracker_looks import key, looks
from follower_vision import ope


def render(
    rows: Sequence[Row],
    attributes: Sequence[AttributeRow],
    runs: Sequence[Scored],
    sequences: Sequence[ope.Sequence],
    remarks: Sequence[str],
) -> str:
    """Return the page.

    Args:
        rows: the means, best first.
        attributes: the means by attribute.
        runs: every run.
        sequences: what was run over.
        remarks: what the reader has to know, e.g. what was skipped.
    """
    page = resources.files("follower.report").joinpath("evaluation.html").read_text("utf-8")
    light, dark = style.css_variables(dark=False), style.css_variables(dark=True)
    names = list(dict.fromkeys(row.tracker for row in rows))
    frames = sum(len(sequence.images) for sequence in sequences)
    subtitle = f"{len(names)} trackers on {len(sequences)} sequences of {frames} frames"
    body = "\n".join(part for part in _parts(rows, attributes, runs, sequences, remarks) if part)
    return Template(page).substitute(light=light, dark=dark, subtitle=subtitle, body=body)


def _parts(
    rows: Sequence[Row],
    attributes: Sequence[AttributeRow],
    runs: Sequence[Scored],
    sequences: Sequence[ope.Sequence],
    remarks: Sequence[str],
) -> tuple[str, ...]:
    once = [one for one in runs if one.kind == "ope"]
    names = list(dict.fromkeys(row.tracker for row in rows))
    found = looks(names)
    table = tables.sequence_table(once, names)
    by_attribute = attribute_plot(attributes, found)
    return (
        html.section("Means", tables.means_table(rows)),
        html.section("Curves", curve_plots([row for row in rows if row.kind == "ope"], found)),
        html.section("What the states are worth", tables.honesty_table(rows)),
        html.section(
            "By attribute",
            key(found, truth=False) if by_attribute else "",
            by_attribute,
            tables.attribute_table(attributes),
        ),
        html.section(
            "Success at 0.5 on each sequence", f'<div class="shades">{table}</div>' if once else ""
        ),
        html.section(
            "Failures",
            html.paragraph(
                "The frames in which trackers have missed their target five times in a row; drawn "
                "are those that miss it there, or all where nobody ever does."
            ),
            key(found),
            pictures(sequences, once, found) if once else "",
        ),
        html.section("Remarks", *(html.paragraph(remark) for remark in remarks)),
    )
