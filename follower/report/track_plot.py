"""The plots of `follower track`: tracks over time, and the setpoints they would have led to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from follower.flightlog import FlightLog
from follower.report import style
from follower.report.flight import Flight
from follower.report.series import Span, boxes, control_times, setpoints
from follower.report.style import BLUE, GREEN, INK, ORANGE, PURPLE, SKY, YELLOW

_BANDS = 0.3
"""Height of a row of state bands, inches."""
_TARGETS = (SKY, ORANGE, PURPLE, YELLOW)
"""The first target's colour, the second's, ..., as in the video."""


def write_track_plot(path: Path, log: FlightLog) -> None:
    """Write a PNG: box centre, scale, confidence and states, and below the setpoints.

    Raises:
        OSError: it cannot be written.
    """
    with style.plot_style():
        style.save_png(track_figure(Flight.of(log)), path)


def write_targets_plot(path: Path, logs: Sequence[FlightLog]) -> None:
    """Write a PNG of several targets in one: states, box centres, scales and confidences.

    Raises:
        OSError: it cannot be written.
    """
    with style.plot_style():
        style.save_png(targets_figure([Flight.of(log) for log in logs]), path)


def track_figure(flight: Flight) -> Figure:
    """Draw the plot, within `style.plot_style`; a log without anything gives empty panels."""
    setpoint_heights = [1.2, 1.2] if flight.log.controls else []
    heights = [_BANDS, 1.3, 1.0, 1.0, *setpoint_heights]
    figure, axes = style.time_panels(heights, flight.length_s)
    _draw_bands(axes[0], [("target", flight.seen)])
    draw_track_panels(axes[1:4], flight)
    if setpoint_heights:
        _draw_setpoints(axes[4], axes[5], flight)
    return figure


def targets_figure(flights: Sequence[Flight]) -> Figure:
    """Draw the plot of several targets, within `style.plot_style`."""
    length_s = max(flight.length_s for flight in flights)
    figure, axes = style.time_panels([_BANDS * len(flights), 1.3, 1.3, 1.0, 1.0], length_s)
    _draw_bands(axes[0], [(str(n), flight.seen) for n, flight in enumerate(flights, 1)])
    for number, flight in enumerate(flights, 1):
        tracks = flight.log.tracks
        time = np.array([record.captured_s - flight.start_s for record in tracks], np.float64)
        table = boxes(tracks)
        colour = _TARGETS[(number - 1) % len(_TARGETS)]
        for column, panel in enumerate(axes[1:]):
            style.curve(panel, time, table[:, column], colour, f"target {number}")
    names = ("x, to the right [px]", "y, downwards [px]", "scale [px]", "confidence")
    for panel, name in zip(axes[1:], names, strict=True):
        panel.set_ylabel(name)
    axes[-1].set_ylim(-0.02, 1.02)
    style.legend(axes[1])
    return figure


def _draw_bands(axes: Axes, rows: Sequence[tuple[str, Sequence[Span]]]) -> None:
    """Draw named rows of states, the first on top."""
    states = {span.state for _, spans in rows for span in spans}
    for row, (_, spans) in enumerate(rows):
        below = 1 - (row + 1) / len(rows)
        for span in spans:
            colour = style.TRACK_STATES[span.state].light
            height = below, below + 0.92 / len(rows)
            axes.axvspan(span.start_s, span.end_s, *height, facecolor=colour, linewidth=0)
    occurring = [name for name in style.TRACK_STATES if name in states]
    axes.set_ylim(0, 1)
    axes.set_yticks(
        [1 - (row + 0.54) / len(rows) for row in range(len(rows))], [n for n, _ in rows]
    )
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
