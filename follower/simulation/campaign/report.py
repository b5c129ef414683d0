"""The plots of a campaign's report: distributions, heat map, pass rates, parallel coordinates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from follower.campaign.figures import Figures
from follower.campaign.goals import Goals
from follower.campaign.wilson import wilson
from follower.report import html, style

Row = dict[str, Any]

_BINS = 5
_MOST_LINES = 400
_NEVER_S = 5.0
_LETTERS = 34


def distributions(rows: Sequence[Row], goals: Goals) -> str:
    """Return the distribution of each figure over the runs, with its limit."""
    figures = [Figures.from_dict(row) for row in rows]
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
    said = (
        "Share of the runs (of the occlusions, third panel) up to each value; dashed: the limit. "
        "Line of sight and time out of the frame are taken outside occlusions. "
        f"A target never seen again counts as {_NEVER_S:g} s. The keep-out's limit is a least one."
    )
    return html.figure(svg, said)


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


def heat_map(rows: Sequence[Row]) -> str:
    """Return the share of passed runs for each scenario and value of the first named parameter."""
    name = next((n for n in _parameters(rows) if _is_named(rows, n)), None)
    if name is None:
        return ""
    across = list(dict.fromkeys(str(row["values"][name]) for row in rows))
    down = sorted({(row["scenario"], row["autopilot"]) for row in rows})
    cells = [
        [
            _share(
                row["passed"]
                for row in rows
                if (row["scenario"], row["autopilot"]) == which and str(row["values"][name]) == one
            )
            for one in across
        ]
        for which in down
    ]
    return _shaded_table([f"{_label(s)}, {a}" for s, a in down], across, cells, name)


def _shaded_table(
    down: Sequence[str],
    across: Sequence[str],
    cells: Sequence[Sequence[tuple[int, int]]],
    name: str,
) -> str:
    rows: list[list[html.Cell]] = [
        [label, *(_shaded(*cell) for cell in line)] for label, line in zip(down, cells, strict=True)
    ]
    head = ["", *across]
    said = f"Runs that reached every goal of their own, by scenario, autopilot and {name}."
    return html.table(head, rows, range(1, len(head))) + html.paragraph(said)


def _shaded(good: int, count: int) -> html.Html:
    if count == 0:
        return html.Html("–")
    percent = round(100 * good / count)
    colour = f"color-mix(in srgb, var(--green) {round(0.55 * percent)}%, transparent)"
    red = f"color-mix(in srgb, var(--red) {round(0.45 * (100 - percent))}%, {colour})"
    look = f"background: {red}; padding: .1rem .5rem; border-radius: .2rem"
    return html.Html(f'<span style="{look}">{percent} % of {count}</span>')


def failures_by_parameter(rows: Sequence[Row]) -> str:
    """Return the share of passed runs over each parameter, with its interval."""
    names = ["scenario", "autopilot", *_parameters(rows)]
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
        good, count = _share(row["passed"] for row in members)
        low, high = wilson(good, count)
        share = good / count if count else 0.0
        axes.plot([place, place], [low, high], color=style.BLUE.light, linewidth=1.5)
        axes.plot([place], [share], "o", color=style.BLUE.light, markersize=4)
    labels = [label for label, _ in groups]
    crowded = sum(len(label.split("\n")[0]) for label in labels) > _LETTERS
    axes.set_xticks(range(len(groups)), labels, fontsize=6.5 if crowded else 7.5)
    axes.set_xlim(-0.5, len(groups) - 0.5)
    axes.set_ylim(0, 1.02)
    axes.set(title=name, ylabel="passed")


def _groups(name: str, rows: Sequence[Row]) -> list[tuple[str, list[Row]]]:
    """Return the runs by a parameter's values; numbers in a few ranges."""
    value: Callable[[Row], Any] = (
        (lambda row: row[name]) if name in ("scenario", "autopilot") else
        (lambda row: row["values"][name])
    )  # fmt: skip
    values = sorted({value(row) for row in rows}, key=_in_order)
    if len(values) <= 2 * _BINS or not all(isinstance(one, int | float) for one in values):
        return [(_label(one), [row for row in rows if value(row) == one]) for one in values]
    edges = np.linspace(min(values), max(values), _BINS + 1)
    places = np.clip(np.digitize([value(row) for row in rows], edges) - 1, 0, _BINS - 1)
    return [
        (
            f"{_short(edges[i])}–\n{_short(edges[i + 1])}",
            [row for row, place in zip(rows, places.tolist(), strict=True) if place == i],
        )
        for i in range(_BINS)
    ]


def _short(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 10 else f"{value:.2g}"


def parallel_coordinates(rows: Sequence[Row]) -> str:
    """Return one line a run over all parameters and the main figures."""
    shown = list(rows[:_MOST_LINES])
    if not shown:
        return ""
    columns: list[tuple[str, list[Any]]] = [
        ("scenario", [_label(row["scenario"]) for row in shown])
    ]
    columns += [(name, [row["values"][name] for row in shown]) for name in _parameters(rows)]
    columns += [
        ("line of sight [deg]", [row["line_of_sight_box_rms_seen_deg"] for row in shown]),
        ("in frame [%]", [_percent(row["in_frame_share"]) for row in shown]),
    ]
    figure = Figure(figsize=(style.WIDTH_IN, 4.0), layout="constrained")
    axes = figure.subplots()
    heights = np.array([_heights(axes, i, values) for i, (_, values) in enumerate(columns)]).T
    rng = np.random.default_rng(0)
    heights += rng.uniform(-0.012, 0.012, heights.shape)
    for passed, colour in ((False, style.RED), (True, style.BLUE)):
        lines = [
            np.column_stack([np.arange(len(columns)), line])
            for line, row in zip(heights, shown, strict=True)
            if row["passed"] is passed
        ]
        axes.add_collection(LineCollection(lines, colors=colour.light, linewidths=0.7, alpha=0.45))
    axes.set_xticks(range(len(columns)), [name for name, _ in columns], fontsize=7.5)
    axes.set_xlim(-0.2, len(columns) - 0.6)
    axes.set_ylim(-0.06, 1.08)
    axes.set_yticks([])
    axes.grid(visible=True, axis="x")
    svg = style.to_svg(figure, "parallel", "all runs over their parameters")
    return html.figure(
        svg,
        f"Each line is a run: orange missed a goal of its own; the first {len(shown)} of them. "
        "Each axis from its smallest to its largest value; what was not measured is at the "
        "bottom.",
    )


def _in_order(value: Any) -> tuple[bool, float, str]:
    """Put numbers by their size, and texts by the alphabet after them."""
    is_number = isinstance(value, int | float)
    return not is_number, float(value) if is_number else 0.0, str(value)


def _label(value: Any) -> str:
    """Return a value as axes show it: of a scenario of one's own, the name of its file."""
    text = str(value)
    name = Path(text).stem if text.endswith((".yaml", ".yml")) else text
    return name.removeprefix("pursue-")


def _heights(axes: Axes, place: int, values: Sequence[Any]) -> list[float]:
    """Return where on its axis each value lies, 0 to 1, and write the ends beside it."""
    if all(isinstance(one, int | float) or one is None for one in values):
        known = [float(one) for one in values if one is not None] or [0.0]
        low, high = min(known), max(known)
        if low == high:  # at the bottom lies what was not measured
            axes.text(place + 0.03, 0.525, f"{low:.3g}", fontsize=6.5)
            return [0.0 if one is None else 0.5 for one in values]
        for height, text in ((0.0, f"{low:.3g}"), (1.0, f"{high:.3g}")):
            axes.text(place + 0.03, height + 0.025, text, fontsize=6.5)
        return [0.0 if one is None else (one - low) / (high - low) for one in values]
    names = sorted({str(one) for one in values})
    spread = max(1, len(names) - 1)
    for number, name in enumerate(names):
        axes.text(place + 0.03, number / spread + 0.025, name, fontsize=6.5)
    return [names.index(str(one)) / spread for one in values]


def _parameters(rows: Sequence[Row]) -> list[str]:
    return list(rows[0]["values"]) if rows else []


def _is_named(rows: Sequence[Row], name: str) -> bool:
    return any(isinstance(row["values"][name], str) for row in rows)


def _share(flags: Any) -> tuple[int, int]:
    counted = list(flags)
    return sum(counted), len(counted)


def _known(values: Sequence[float | None]) -> list[float]:
    return [value for value in values if value is not None]


def _percent(share: float | None) -> float | None:
    return None if share is None else 100 * share


def _nearness(figures: Figures) -> float | None:
    if figures.nearest_m is None or figures.keep_out_m is None:
        return None
    return figures.nearest_m / figures.keep_out_m
