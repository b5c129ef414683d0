"""How well the turns in a video fit a gyro's, drawn."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from follower.report import html, style
from follower.report.style import BLUE, INK, ORANGE
from follower_control.timeoffset import TimeOffset

_AXES = ("roll rate [°/s]", "pitch rate [°/s]", "yaw rate [°/s]")


def offset_facts(found: TimeOffset) -> dict[str, float]:
    """Return the offset and its quality, rounded to what they are worth."""
    return {
        "seconds": round(found.offset_s, 4),
        "plus_or_minus_s": round(found.unsure_s, 4),
        "correlation": round(found.peak, 3),
        "next_best_correlation": round(found.second, 3),
        "image_turns_per_gyro": round(found.scale, 3),
        "turning_deg_s": round(math.degrees(found.rate_rad_s), 2),
    }


def offset_figure(found: TimeOffset) -> Figure:
    """Draw both recordings' turns on top of each other, and the correlation over the offset."""
    figure = Figure(figsize=(style.WIDTH_IN, 6.6))
    curves = figure.add_gridspec(3, 1, left=0.085, right=0.985, top=0.95, bottom=0.38, hspace=0.25)
    below = figure.add_subplot(
        figure.add_gridspec(1, 1, left=0.085, right=0.985, top=0.25, bottom=0.075)[0]
    )
    axes = [figure.add_subplot(curves[row]) for row in range(len(_AXES))]
    _draw_turns(axes, found)
    style.curve(below, found.lags_s, found.correlation, BLUE)
    below.axvline(found.offset_s, color=ORANGE.light, linewidth=1.3, label="chosen")
    below.set_ylabel("correlation")
    below.set_xlabel("offset: log's time minus video's time [s]")
    style.legend(below)
    figure.align_ylabels([*axes, below])
    return figure


def _draw_turns(axes: Sequence[Axes], found: TimeOffset) -> None:
    camera, gyro = np.degrees(found.camera_rad_s), np.degrees(found.gyro_rad_s)
    for column, name in enumerate(_AXES):
        style.curve(axes[column], found.time_s, camera[:, column], ORANGE, "image", width=2.2)
        style.curve(axes[column], found.time_s, gyro[:, column], INK, "gyro", width=0.9)
        axes[column].set_ylabel(name)
        axes[column].set_xlim(found.time_s[0], found.time_s[-1])
        axes[column].tick_params(labelbottom=column == len(_AXES) - 1)
    axes[-1].set_xlabel("video's time [s]")
    style.legend(axes[0])


def write_offset_plot(path: Path, found: TimeOffset) -> None:
    """Write the drawing as a PNG.

    Raises:
        OSError: it cannot be written.
    """
    with style.plot_style():
        style.save_png(offset_figure(found), path)


def offset_section(found: TimeOffset) -> str:
    """Return the drawing and the figures for a report."""
    facts = [(name.replace("_", " "), f"{value:g}") for name, value in offset_facts(found).items()]
    with style.plot_style():
        svg = style.to_svg(offset_figure(found), "timeoffset", "Time offset")
    said = (
        "The quick turns that the image shows (slow ones are taken out of both) and the gyro's, "
        "moved by the offset; below, how well they agree at other offsets."
    )
    return html.section(
        "Time offset between video and telemetry",
        html.figure(svg, said),
        html.table(("Figure", "Value"), facts, numbers=(1,)),
    )
