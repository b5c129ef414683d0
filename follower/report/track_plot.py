"""The plot of `follower track`: the track over time, and the setpoints it would have led to."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from follower.flightlog import FlightLog
from follower.report import style
from follower.report.flight import Flight
from follower.report.series import boxes, control_times, setpoints
from follower.report.style import BLUE, GREEN, INK, ORANGE, PURPLE

_BANDS = 0.3
"""Height of the panel of state bands, inches."""


def write_track_plot(path: Path, log: FlightLog) -> None:
    """Write a PNG: box centre, scale, confidence and states, and below the setpoints.

    Raises:
        OSError: it cannot be written.
    """
    with style.plot_style():
        style.save_png(track_figure(Flight.of(log)), path)


def track_figure(flight: Flight) -> Figure:
    """Draw the plot, within `style.plot_style`; a log without anything gives empty panels."""
    heights = [_BANDS, 1.3, 1.0, 1.0, 1.2, 1.2]
    figure, axes = style.time_panels(heights, flight.length_s)
    _draw_bands(axes[0], flight)
    draw_track_panels(axes[1:4], flight)
    _draw_setpoints(axes[4], axes[5], flight)
    return figure


def _draw_bands(axes: Axes, flight: Flight) -> None:
    for span in flight.seen:
        colour = style.TRACK_STATES[span.state].light
        axes.axvspan(span.start_s, span.end_s, facecolor=colour, linewidth=0)
    occurring = [name for name in style.TRACK_STATES if any(s.state == name for s in flight.seen)]
    axes.set_yticks([0.5], ["target"])
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False)
    axes.legend(
        handles=[Patch(facecolor=style.TRACK_STATES[name].light, label=name) for name in occurring],
        loc="lower left",
        bbox_to_anchor=(0.0, 0.99),
        ncols=max(1, len(occurring)),
        borderaxespad=0.2,
    )


def draw_track_panels(axes: list[Axes], flight: Flight) -> None:
    """Draw the box's centre, its scale and the confidence over time into three panels."""
    tracks = flight.log.tracks
    time = np.array([record.captured_s - flight.start_s for record in tracks], np.float64)
    table = boxes(tracks)
    style.curve(axes[0], time, table[:, 0], BLUE, "x, to the right")
    style.curve(axes[0], time, table[:, 1], ORANGE, "y, downwards")
    style.curve(axes[1], time, table[:, 2], PURPLE)
    style.curve(axes[2], time, table[:, 3], GREEN)
    axes[2].set_ylim(-0.02, 1.02)
    for panel, name in zip(axes, ("centre [px]", "scale [px]", "confidence"), strict=True):
        panel.set_ylabel(name)
        style.shade(panel, flight.seen, style.UNSEEN)
    style.legend(axes[0])


def _draw_setpoints(velocity: Axes, yaw_rate: Axes, flight: Flight) -> None:
    controls = flight.log.controls
    time, allowed = control_times(controls, flight.start_s), setpoints(controls, "allowed")
    allowed[[not record.sent for record in controls]] = math.nan
    for column, (name, colour) in enumerate((("forward", BLUE), ("right", ORANGE), ("up", GREEN))):
        style.curve(velocity, time, allowed[:, column], colour, name)
    style.curve(yaw_rate, time, allowed[:, 3], INK)
    velocity.set_ylabel("setpoint [m/s]")
    yaw_rate.set_ylabel("yaw rate [°/s]")
    style.legend(velocity)
