"""The report of a campaign: one HTML file that needs no network."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from follower.report import flight_page, html, style
from follower.report.html import Cell, Html
from follower.report.series import ReportMeta
from follower.simulation.campaign.config import CampaignConfig, Goals
from follower.simulation.campaign.metrics import RunMetrics
from follower.simulation.campaign.summary import (
    CampaignSummary,
    reacquired_by_length,
    share_text,
    wilson,
)
from follower.simulation.options import VisionSource
from follower_sim.noisy_tracker import LABEL

Row = dict[str, Any]

_MOST_WORST = 25
_BINS, _LETTERS = 5, 34
_NEVER_S = 5.0
"""What a target that was never seen again counts as."""
_HOW_SURE = (
    "In brackets: the 95 % score interval (Wilson, 1927) of the counted share. Each run flies its "
    "own draw of the parameters; a goal over all runs can be met although single runs miss theirs."
)
_VERDICTS = {
    "met": Html('<b style="color: var(--green); white-space: nowrap">met</b>'),
    "not met": Html('<b style="color: var(--red); white-space: nowrap">not met</b>'),
    "": Html(""),
}


def goals_table(summary: CampaignSummary) -> str:
    """Return each goal with what was reached."""
    rows = [
        (line.name, line.value, line.wanted if line.counts else "", _VERDICTS[line.verdict])
        for line in summary.lines
    ]
    return html.table(("Goal", "Reached", "Wanted", ""), rows)


def _by_length(rows: Sequence[Row], goals: Goals) -> str:
    figures = [RunMetrics.from_dict(row) for row in rows]
    head = ("Hidden for", f"Re-acquired within {goals.reacquired_s:g} s")
    return html.table(head, reacquired_by_length(figures, goals.reacquired_s))


def worst_table(summary: CampaignSummary, seen: Mapping[int, str]) -> str:
    """Return the worst runs, each with its command, and its video where there is one."""
    worst = summary.worst[:_MOST_WORST]
    if not worst:
        return html.paragraph("No run failed.")
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


def distributions(rows: Sequence[Row], goals: Goals) -> str:
    """Return the distribution of each figure over the runs, with its limit."""
    figures = [RunMetrics.from_dict(row) for row in rows]
    waits = [t for one in figures for t in goals.short(one)]
    panels: tuple[tuple[str, list[float], float | None], ...] = (
        (
            "line-of-sight error, RMS [deg]",
            _known([one.line_of_sight_box_rms_seen_deg for one in figures]),
            goals.max_line_of_sight_rms_deg,
        ),
        (
            "time out of the frame [%]",
            [100 * (1 - s) for s in _known([one.in_frame_share for one in figures])],
            100 * (1 - goals.min_in_frame_share),
        ),
        (
            f"re-acquired after [s], if hidden ≤ {goals.occlusion_s:g} s",
            [_NEVER_S if t is None else min(t, _NEVER_S) for t in waits],
            goals.reacquired_s,
        ),
        (
            "range error, median [%]",
            [100 * e for e in _known([one.range_error_median for one in figures])],
            None,
        ),
        ("approach [s]", _known([one.approach_s for one in figures]), None),
        ("least distance over keep-out", _known([_nearness(one) for one in figures]), 1.0),
    )
    figure = Figure(figsize=(style.WIDTH_IN, 5.0), layout="constrained")
    for axes, (name, values, limit) in zip(
        figure.subplots(2, 3).ravel().tolist(), panels, strict=True
    ):
        _cumulative(axes, name, values, limit)
    svg = style.to_svg(figure, "distributions", "distributions of the figures")
    caption = (
        "Share of the runs (of the occlusions, third panel) up to each value; dashed: the limit. "
        "Line of sight and time out of the frame are taken outside occlusions. "
        f"A target never seen again counts as {_NEVER_S:g} s. The keep-out's limit is a least one."
    )
    return html.figure(svg, caption)


def _cumulative(axes: Axes, name: str, values: Sequence[float], limit: float | None) -> None:
    ordered = np.sort(np.asarray(values, np.float64))
    shares = np.arange(1, len(ordered) + 1) / max(1, len(ordered))
    axes.step(ordered, shares, where="post", color=style.BLUE.light)
    if limit is not None:
        axes.axvline(limit, color=style.RED.light, linestyle=(0, (5, 3)), linewidth=1)
    axes.set_ylim(0, 1.02)
    axes.set_xlabel(name, fontsize=8)
    axes.set_ylabel("share", fontsize=8)
    if len(ordered):
        most = max(float(np.quantile(ordered, 0.99)), 1.3 * (limit or 0.0), 1e-3)
        axes.set_xlim(min(0.0, float(ordered[0])), most * 1.05)


def failures_by_parameter(rows: Sequence[Row]) -> str:
    """Return the share of passed runs over each parameter, with its interval."""
    names = ["scenario", "autopilot", *(rows[0]["values"] if rows else ())]
    count = len(names)
    lines = (count + 2) // 3
    figure = Figure(figsize=(style.WIDTH_IN, 2.3 * lines + 0.3), layout="constrained")
    panels = figure.subplots(lines, 3, squeeze=False).ravel().tolist()
    for axes in panels[count:]:
        axes.set_visible(False)
    for axes, name in zip(panels, names, strict=False):
        _pass_rates(axes, name, rows)
    svg = style.to_svg(figure, "parameters", "pass rates by parameter")
    return html.figure(svg, "Runs that reached every goal of their own, with 95 % intervals.")


def _pass_rates(axes: Axes, name: str, rows: Sequence[Row]) -> None:
    groups = _groups(name, rows)
    for place, (_, members) in enumerate(groups):
        good, count = sum(row["passed"] for row in members), len(members)
        low, high = wilson(good, count)
        share = good / count if count else 0.0
        axes.plot([place, place], [low, high], color=style.BLUE.light, linewidth=1.5)
        axes.plot([place], [share], "o", color=style.BLUE.light, markersize=4)
    labels = [style.literal(label) for label, _ in groups]
    crowded = sum(len(label.split("\n")[0]) for label in labels) > _LETTERS
    axes.set_xticks(range(len(groups)), labels, fontsize=6.5 if crowded else 7.5)
    axes.set_xlim(-0.5, len(groups) - 0.5)
    axes.set_ylim(0, 1.02)
    axes.set(title=name, ylabel="passed")


def _groups(name: str, rows: Sequence[Row]) -> list[tuple[str, list[Row]]]:
    """Return the runs by a parameter's values; numbers in a few ranges."""
    of_rows = [
        row[name] if name in ("scenario", "autopilot") else row["values"][name] for row in rows
    ]
    values = sorted(set(of_rows), key=_in_order)
    if len(values) <= 2 * _BINS or not all(isinstance(one, int | float) for one in values):
        return [
            (_label(one), [row for row, its in zip(rows, of_rows, strict=True) if its == one])
            for one in values
        ]
    edges = np.linspace(min(values), max(values), _BINS + 1)
    places = np.clip(np.digitize(of_rows, edges) - 1, 0, _BINS - 1)
    return [
        (
            f"{_edge(edges[i])}–\n{_edge(edges[i + 1])}",
            [row for row, place in zip(rows, places.tolist(), strict=True) if place == i],
        )
        for i in range(_BINS)
    ]


def _edge(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 10 else f"{value:.2g}"


def _in_order(value: Any) -> tuple[bool, float, str]:
    """Put numbers by their size, and texts by the alphabet after them."""
    is_number = isinstance(value, int | float)
    return not is_number, float(value) if is_number else 0.0, str(value)


def _label(value: Any) -> str:
    """Return a value as axes show it: of a scenario of one's own, the name of its file."""
    text = str(value)
    name = Path(text).stem if text.endswith((".yaml", ".yml")) else text
    return name.removeprefix("pursue-")


def _known(values: Sequence[float | None]) -> list[float]:
    return [value for value in values if value is not None]


def _nearness(figures: RunMetrics) -> float | None:
    if figures.nearest_m is None or figures.keep_out_m is None:
        return None
    return figures.nearest_m / figures.keep_out_m


def render(
    config: CampaignConfig,
    rows: Sequence[Row],
    summary: CampaignSummary,
    seen: Mapping[int, str],
) -> str:
    """Return the page.

    Args:
        config: what was asked for.
        rows: the judged rows, one a run.
        summary: what they come to.
        seen: the folders of the runs that were flown again with video, by the runs' numbers.
    """
    source = LABEL if config.vision is VisionSource.TRUTH else "full pixels"
    subtitle = (
        f"campaign {config.name} · {summary.runs} runs · seed {config.seed} · lockstep · {source}"
    )
    flown = [row for row in rows if not row["error"]]
    passed = share_text(summary.passed, summary.runs)
    missed = [(name, share_text(count, summary.runs)) for name, count in summary.failures]
    with style.plot_style():
        parts = (
            _verdict(config, summary),
            html.tiles((("Runs that reached every goal of their own", passed),)),
            html.section("Goals", goals_table(summary), html.paragraph(_HOW_SURE)),
            html.section("What was missed", html.table(("Runs that missed", "Share"), missed)),
            html.section("Re-acquisition by length of cover", _by_length(flown, config.goals)),
            html.section("Distributions", distributions(flown, config.goals)),
            html.section("Passing by parameter", failures_by_parameter(rows)),
            html.section("The worst runs", worst_table(summary, seen)),
            html.section("This campaign", _about(config, rows)),
        )
    return flight_page.filled(ReportMeta(config.title, subtitle), parts)


def _verdict(config: CampaignConfig, summary: CampaignSummary) -> str:
    lines = [
        f"{line.name}: {line.value}, wanted {line.wanted}" for line in summary.goals if not line.met
    ]
    if config.vision is VisionSource.TRUTH:
        lines.insert(0, f"{LABEL[0].upper()}{LABEL[1:]}: this says nothing about trackers.")
    if summary.errors:
        lines.append(f"{summary.errors} runs could not be flown.")
    kind = "passed" if summary.reached else "failed"
    met = sum(line.met for line in summary.goals)
    return flight_page.verdict_box(kind, f"{met} of {len(summary.goals)} goals met", lines)


def _about(config: CampaignConfig, rows: Sequence[Row]) -> str:
    wall_s = sum(float(row.get("wall_s", 0.0)) for row in rows)
    versions = sorted({str(row["version"]) for row in rows})
    facts = [("Version", ", ".join(versions)), ("Time in flights", f"{wall_s:.0f} s")]
    return html.table(("Fact", "Value"), facts) + html.folded(
        "The campaign as resolved", html.preformatted(config.to_yaml())
    )
