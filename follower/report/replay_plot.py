"""Plots of a replay: the recorded and the replayed curves, and how their difference grows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from follower.flightlog import FlightLog
from follower.replay.comparison import Comparison
from follower.report.series import boxes, control_times, setpoints
from follower.report.style import INK, MUTED, ORANGE, PALETTE, WIDTH_IN

_SHOWN = 8


def write_replay_plot(
    path: Path, recorded: FlightLog, replayed: FlightLog, comparison: Comparison, title: str
) -> None:
    """Draw box and setpoints of both, and the differences on a logarithmic axis.

    Raises:
        OSError: the file cannot be written.
    """
    figure = Figure(figsize=(WIDTH_IN, 11), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(6, 1, sharex=True, height_ratios=[1, 1, 1, 1, 1, 1.6])
    figure.suptitle(title, fontsize=11)
    _draw_boxes(axes[:2], recorded, replayed)
    _draw_setpoints(axes[2:5], recorded, replayed)
    _draw_differences(axes[5], comparison)
    axes[-1].set_xlabel("time, s")
    for ax in axes:
        ax.grid(visible=True, color="#e1e5ea")
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].legend(loc="upper right", fontsize=8)
    figure.savefig(path, dpi=110)


def _draw_boxes(axes: Sequence[Axes], recorded: FlightLog, replayed: FlightLog) -> None:
    for log, style in ((recorded, _RECORDED), (replayed, _REPLAYED)):
        time_s = [record.captured_s for record in log.tracks]
        table = boxes(log.tracks)
        axes[0].plot(time_s, table[:, 0], **style)
        axes[1].plot(time_s, table[:, 2], **style)
    axes[0].set_ylabel("box centre x, px")
    axes[1].set_ylabel("box scale, px")


def _draw_setpoints(axes: Sequence[Axes], recorded: FlightLog, replayed: FlightLog) -> None:
    columns = ((0, "forward, m/s"), (2, "up, m/s"), (3, "yaw rate, °/s"))
    for log, style in ((recorded, _RECORDED), (replayed, _REPLAYED)):
        time_s, table = control_times(log.controls, 0.0), setpoints(log.controls, "allowed")
        for ax, (column, label) in zip(axes, columns, strict=True):
            ax.plot(time_s, table[:, column], **style)
            ax.set_ylabel(label)


def _draw_differences(ax: Axes, comparison: Comparison) -> None:
    numbers = [one for one in comparison.differing if one.is_number]
    colours = [colour.light for colour in PALETTE[4:]]
    ax.set_ylabel("difference so far")
    if not numbers:
        ax.text(0.5, 0.5, "no difference", transform=ax.transAxes, ha="center", color=MUTED.light)
        return
    for number, one in enumerate(numbers[:_SHOWN]):
        grown = np.maximum.accumulate(one.amounts)
        unit = f", {one.unit}" if one.unit else ""
        colour = colours[number % len(colours)]
        shown = np.where(grown > 0, grown, np.nan)
        ax.plot(one.times_s, shown, color=colour, label=f"{one.name}{unit}", linewidth=1.2)
    ax.set_yscale("log")
    ax.legend(fontsize=7, ncols=2, loc="lower right")


_RECORDED: dict[str, Any] = {"color": INK.light, "linewidth": 1.6, "label": "recorded"}
_REPLAYED: dict[str, Any] = {
    "color": ORANGE.light,
    "linewidth": 1.0,
    "linestyle": "--",
    "label": "replayed",
}
