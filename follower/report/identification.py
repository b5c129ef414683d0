"""The report of an identification: what was recorded beside what the models say."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from follower.identify.identify import UNITS, model_row
from follower.identify.recording import VehicleAxis
from follower.identify.result import Identification
from follower.report import html, sections, style
from follower.report.meta import ReportMeta
from follower.report.series import Array
from follower.report.style import BLUE, INK, PALE, YELLOW
from follower.report.writer import write_whole
from follower_control.tuning.fit import ResponseFit
from follower_control.tuning.response_data import ResponseData

_GAP_S = 1.5
_LONGEST = 8


def write_identification(path: Path, found: Identification, command: str) -> Path:
    """Write the page and return its path."""
    meta = ReportMeta(
        "How the vehicle answers",
        f"identified from {', '.join(found.sources[:6])}{' …' if len(found.sources) > 6 else ''}",
        command,
        files=(("vehicle.yaml", "the models, for `follower tune`"),),
    )
    with style.plot_style():
        return write_whole(path, sections.filled(meta, _parts(found, meta)))


def axis_figure(axis: VehicleAxis, fit: ResponseFit, data: Sequence[ResponseData]) -> Figure:
    """Draw the recordings of one axis one after the other, the held-out parts tinted."""
    chosen = list(zip(data, fit.offsets, fit.splits_s, strict=True))[:_LONGEST]
    scale = 180 / np.pi if axis.is_turn else 1.0
    length_s = sum(one.length_s + _GAP_S for one, _, _ in chosen)
    figure, (panel,) = style.time_panels([2.6], length_s)
    at_s = 0.0
    for number, (one, offset, split_s) in enumerate(chosen):
        shift = at_s - one.output_s[0]
        labels = ("asked for", "recorded", "model") if number == 0 else ("", "", "")
        end_s = one.output_s[-1]
        panel.axvspan(
            split_s + shift, end_s + shift, color=YELLOW.light, alpha=0.18, lw=0, zorder=0
        )
        times, levels = _held(one)
        style.curve(panel, times + shift, scale * levels, PALE, labels[0])
        style.curve(panel, one.output_s + shift, scale * one.outputs, INK, labels[1], width=0.9)
        model = one.predicted(fit.judged) + offset
        style.curve(panel, one.output_s + shift, scale * model, BLUE, labels[2])
        at_s += one.length_s + _GAP_S
    panel.set_ylabel(f"{axis} [{'deg/s' if axis.is_turn else 'm/s'}]")
    style.legend(panel)
    return figure


def _held(one: ResponseData) -> tuple[Array, Array]:
    """Return the inputs as a staircase between the first and the last sample."""
    times = np.repeat(one.input_s, 2)[1:]
    levels = np.repeat(one.inputs, 2)[:-1]
    inside = (times >= one.output_s[0] - 0.5) & (times <= one.output_s[-1])
    end = np.append(times[inside], one.output_s[-1])
    last = levels[inside][-1] if inside.any() else 0.0
    return end, np.append(levels[inside], last)


def _parts(found: Identification, meta: ReportMeta) -> list[str]:
    rows = [model_row(axis, fit) for axis, fit in found.fits.items()]
    head = ("Axis", "Order", "Gain", "Dead time [s]", "Time constant [s]", "Damping")
    table = html.table((*head, "Rate limit", "Held-out fit"), rows, numbers=(7,))
    note = html.paragraph(
        "In brackets: 95 % intervals. The held-out fit is 100 % for a model that predicts, from "
        "what was asked for alone, all that it was not fitted to, and 0 % for one that is no "
        "better than a constant. Rate limits are in the axis' unit per second: "
        + ", ".join(f"{axis} {unit}" for axis, unit in UNITS.items())
        + "."
    )
    return [
        sections.verdict_box("", "Read the plots before you tune by them", found.remarks),
        html.section("Models", table, note),
        *(_axis_section(axis, fit, found.data[axis]) for axis, fit in found.fits.items()),
        html.section("Delays and the target", _times(found)),
        sections.about(meta),
    ]


def _axis_section(axis: VehicleAxis, fit: ResponseFit, data: Sequence[ResponseData]) -> str:
    svg = style.to_svg(axis_figure(axis, fit, data), f"axis{axis.replace('_', '')}", escape(axis))
    caption = (
        "Grey: what was sent. Black: what telemetry said. Blue: what the model says, from the grey "
        "curve alone. The tinted parts were held out: the blue curve never saw them."
    )
    return html.section(axis.replace("_", " ").capitalize(), html.figure(svg, caption))


def _times(found: Identification) -> str:
    rows = [
        (
            name,
            f"{1e3 * one.median.value:.1f} ms ({1e3 * one.median.low:.1f}–"
            f"{1e3 * one.median.high:.1f})",
            f"{1e3 * one.most:.1f} ms",
            str(one.samples),
        )
        for name, one in found.delays.items()
    ]
    if found.size is not None:
        size, slope = found.size.size_m, found.size.slope
        more = ""
        if slope is not None:
            more = f", slope {slope.value:.2f} ({slope.low:.2f}–{slope.high:.2f})"
        said = f"{size.value:.3f} m ({size.low:.3f}–{size.high:.3f}){more}"
        spread = f"single sightings ±{100 * found.size.spread:.0f} %"
        rows.append(("target_size_m", said, spread, str(found.size.samples)))
    return html.table(("What", "Median", "95 % below", "Samples"), rows, numbers=(3,))
