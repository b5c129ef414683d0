"""The plots of an evaluation: curves over thresholds, and success by attribute."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from follower.evaluate.summary import AttributeRow, Row
from follower.report import html, style
from follower.report.tracker_looks import Look
from follower_vision.curves import NORMALISED_AT, PRECISION_AT, SUCCESS_AT

_MOST_ATTRIBUTES = 24
_WIDTH_IN = 4.7
_ATTRIBUTES_IN = 5.6


def curve_plots(rows: Sequence[Row], looks: Mapping[str, Look]) -> str:
    """Return success, precision and normalised precision, a plot each."""
    plots = (
        _plot("success", "Success", "overlap above", SUCCESS_AT, rows, looks,
              [(row.curves.success, row.score.auc) for row in rows]),
        _plot("precision", "Precision", "centre within [px]", PRECISION_AT, rows, looks,
              [(row.curves.precision, row.score.precision) for row in rows]),
        _plot("normalised", "Normalised precision", "centre within [sides of the box]",
              NORMALISED_AT, rows, looks,
              [(row.curves.normalised, row.curves.normalised_precision) for row in rows]),
    )  # fmt: skip
    said = (
        "One-pass evaluation; each sequence has the same weight. Behind each name: the area under "
        "the success curve, the precision at 20 pixels, the mean of the normalised curve."
    )
    return f'<div class="plots">{"".join(plots)}</div>{html.paragraph(said)}'


def _plot(
    name: str,
    title: str,
    xlabel: str,
    thresholds: NDArray[np.float64],
    rows: Sequence[Row],
    looks: Mapping[str, Look],
    curves: Sequence[tuple[Sequence[float], float]],
) -> str:
    """Draw one curve a tracker, the best figure first in the legend below."""
    legend_in = 0.17 * ((len(rows) + 1) // 2)
    with style.plot_style():
        figure = Figure(figsize=(_WIDTH_IN, 3.3 + legend_in), layout="constrained")
        axes = figure.subplots()
        order = sorted(range(len(rows)), key=lambda index: -curves[index][1])
        for index in order:
            look, (shares, value) = looks[rows[index].tracker], curves[index]
            label = f"{value:.3f} {rows[index].tracker}"
            colour = look.colour.light
            axes.plot(thresholds, shares, color=colour, linestyle=look.dash, label=label)
        axes.set(xlabel=xlabel, ylabel="share of frames", title=title)
        axes.set_ylim(0, 1.02)
        axes.set_xlim(float(thresholds[0]), float(thresholds[-1]))
        figure.legend(loc="outside lower left", ncols=2, fontsize=7.5, handlelength=2.2)
        svg = style.to_svg(figure, name, f"{title} of {len(rows)} trackers")
    return f'<div class="plot">{svg}</div>'


def attribute_plot(rows: Sequence[AttributeRow], looks: Mapping[str, Look]) -> str:
    """Return each tracker's success by attribute, "" without attributes."""
    counts = Counter({row.attribute: row.sequences for row in rows})
    names = sorted(name for name, _ in counts.most_common(_MOST_ATTRIBUTES))
    if not names:
        return ""
    with style.plot_style():
        figure = Figure(figsize=(_ATTRIBUTES_IN, 0.26 * len(names) + 0.7), layout="constrained")
        axes = figure.subplots()
        for row in reversed(rows):
            if row.attribute in names:
                look = looks[row.tracker]
                place = (row.score.auc, names.index(row.attribute))
                axes.plot(*place, look.marker, color=look.colour.light, markersize=5)
        axes.set_yticks(range(len(names)), [f"{name} ({counts[name]})" for name in names])
        axes.set_ylim(len(names) - 0.5, -0.5)
        axes.set_xlim(0, 1)
        axes.set(xlabel="area under the success curve")
        svg = style.to_svg(figure, "attributes", "success by attribute")
    said = "Over the frames with each attribute; in brackets the number of sequences that have it."
    return html.figure(svg, said, "wide")
