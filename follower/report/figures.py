"""The report's figures over time. Each takes a flight and returns a drawing, or None if empty."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from follower.report import style
from follower.report.flight import Flight
from follower.report.series import (
    Array,
    Span,
    boxes,
    control_times,
    directions,
    estimated_ranges,
    setpoints,
)
from follower.report.style import BLUE, GREEN, INK, MUTED, ORANGE, PURPLE
from follower.report.track_plot import draw_track_panels
from follower_sim.score import APPROACH_RANGE, PursuitGoal, line_of_sight_errors

_TROUBLE = {name: style.STATES[name] for name in ("coasting", "searching", "holding", "released")}
_CHARACTER_IN = 0.068
"""About how wide a character of a small label is."""


def states(flight: Flight) -> Figure | None:
    """Draw the supervisor's states as bands, a row for each state that occurs, with reasons."""
    if not flight.states:
        return None
    rows = [name for name in style.STATES if any(s.state == name for s in flight.states)]
    figure, (axes,) = style.time_panels([0.3 * len(rows) + 0.1], flight.length_s, top_in=0.05)
    axes.set_yticks(range(len(rows)), rows)
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)
    axes.tick_params(axis="y", length=0)
    for name in rows:
        _draw_band(axes, [s for s in flight.states if s.state == name], rows.index(name), flight)
    return figure


def _draw_band(axes: Axes, spans: list[Span], row: int, flight: Flight) -> None:
    least_s = flight.length_s / 600
    bars = [(span.start_s, max(span.length_s, least_s)) for span in spans]
    axes.broken_barh(bars, (row - 0.32, 0.64), facecolor=style.STATES[spans[0].state].light)
    width_in = style.WIDTH_IN * 0.9
    nexts = [*(span.start_s for span in spans[1:]), flight.length_s]
    for span, next_s in zip(spans, nexts, strict=True):
        need_s = len(span.reason) * _CHARACTER_IN * max(flight.length_s, 1e-3) / width_in
        room_right = next_s - span.end_s
        if room_right > need_s:
            axes.annotate(
                span.reason,
                (max(span.end_s, span.start_s + least_s), row),
                xytext=(4, 0),
                textcoords="offset points",
                va="center",
                fontsize=8,
                color=MUTED.light,
            )


def line_of_sight(flight: Flight) -> Figure | None:
    """Draw azimuth and elevation of the target from the heading: truth and estimate."""
    controls = flight.log.controls
    if not flight.truth and all(record.estimate is None for record in controls):
        return None
    heights = [1.5, 1.5, 1.1] if flight.truth and flight.goal else [1.5, 1.5]
    figure, axes = style.time_panels(heights, flight.length_s)
    time, estimate = control_times(controls, flight.start_s), directions(controls)
    truth = np.degrees([(s.azimuth_rad, s.elevation_rad) for s in flight.truth]).reshape(-1, 2)
    wanted = (0.0, math.degrees(flight.goal.elevation_rad) if flight.goal else None)
    for column, name in enumerate(("azimuth [°]", "elevation [°]")):
        panel = axes[column]
        if wanted[column] is not None:
            style.level(panel, float(wanted[column] or 0.0), "wanted")
        style.curve(panel, time, estimate[:, column], ORANGE, "estimate", width=2.4)
        style.curve(panel, _truth_times(flight), truth[:, column], INK, "truth", width=0.9)
        panel.set_ylabel(name)
        style.shade(panel, flight.states, _TROUBLE)
    style.legend(axes[0])
    if flight.truth and flight.goal:
        _draw_error(axes[2], flight, flight.goal)
    return figure


def _draw_error(axes: Axes, flight: Flight, goal: PursuitGoal) -> None:
    angle = np.degrees(line_of_sight_errors(flight.truth, goal))
    style.curve(axes, _truth_times(flight), angle, BLUE, "true angle to the wanted direction")
    axes.set_ylabel("error [°]")
    axes.set_ylim(bottom=0)
    _mark_approach(axes, flight)
    style.shade(axes, flight.states, _TROUBLE)
    style.legend(axes)


def distance(flight: Flight) -> Figure | None:
    """Draw range and height: true, estimated and wanted."""
    controls = flight.log.controls
    time = control_times(controls, flight.start_s)
    ranges = estimated_ranges(controls, flight.target_size_m)
    height = flight.motion.position_m[:, 2]
    if not (flight.truth or np.isfinite(ranges).any() or np.isfinite(height).any()):
        return None
    figure, axes = style.time_panels([1.9, 1.1], flight.length_s)
    _draw_wanted_range(axes[0], flight)
    true = np.array([sample.range_m for sample in flight.truth], np.float64)
    style.curve(axes[0], time, ranges, ORANGE, "from the box's size", width=2.4)
    style.curve(axes[0], _truth_times(flight), true, INK, "truth", width=0.9)
    axes[0].set_ylabel("range [m]")
    axes[0].set_ylim(0, _top(true, ranges))
    _mark_approach(axes[0], flight)
    style.curve(axes[1], flight.motion.time_s, height, BLUE, "vehicle")
    target = np.array([-sample.target_position_m[2] for sample in flight.truth], np.float64)
    style.curve(axes[1], _truth_times(flight), target, ORANGE, "target")
    axes[1].set_ylabel("height [m]")
    for panel in axes:
        style.shade(panel, flight.states, _TROUBLE)
        style.legend(panel)
    return figure


def _draw_wanted_range(axes: Axes, flight: Flight) -> None:
    wanted_m = flight.goal.distance_m if flight.goal else None
    if wanted_m is None:
        return
    low, high = (1 - APPROACH_RANGE) * wanted_m, (1 + APPROACH_RANGE) * wanted_m
    axes.axhspan(low, high, facecolor=GREEN.light, alpha=0.12, linewidth=0)
    style.level(axes, wanted_m, "wanted, ± 15 %")


def _mark_approach(axes: Axes, flight: Flight) -> None:
    if flight.approached_s is not None:
        axes.axvline(flight.approached_s, color=MUTED.light, linewidth=1, linestyle=(0, (1, 2)))
        axes.annotate(
            "scored from here",
            (flight.approached_s, 0.93),
            xycoords=("data", "axes fraction"),
            xytext=(4, 0),
            textcoords="offset points",
            va="top",
            fontsize=8,
            color=MUTED.light,
        )


def _top(true: Array, estimated: Array) -> float | None:
    """Return the axis' upper end: a wild estimate of a far box must not flatten the truth."""
    values = true if len(true) else estimated[np.isfinite(estimated)]
    return 1.15 * float(np.percentile(values, 99.5)) + 1 if len(values) else None


def velocities(flight: Flight) -> Figure | None:
    """Draw each axis' velocity and the yaw rate: asked, allowed and flown."""
    controls = flight.log.controls
    if not (any(r.sent for r in controls) or np.isfinite(flight.motion.velocity).any()):
        return None
    figure, axes = style.time_panels([1.35] * 4, flight.length_s)
    time = control_times(controls, flight.start_s)
    asked, allowed = setpoints(controls, "asked"), setpoints(controls, "allowed")
    asked[[not record.sent for record in controls]] = math.nan
    allowed[[not record.sent for record in controls]] = math.nan
    names = ("forward [m/s]", "right [m/s]", "up [m/s]", "yaw rate [°/s]")
    for column, (panel, name) in enumerate(zip(axes, names, strict=True)):
        style.curve(panel, time, asked[:, column], ORANGE, "asked by the servo", width=1.0)
        style.curve(panel, time, allowed[:, column], BLUE, "allowed by the envelope", width=2.4)
        flown = flight.motion.velocity[:, column]
        style.curve(panel, flight.motion.time_s, flown, INK, "flown", width=0.9)
        panel.set_ylabel(name)
        style.shade(panel, flight.states, _TROUBLE)
    style.legend(axes[0])
    return figure


def tilt(flight: Flight) -> Figure | None:
    """Draw roll and pitch."""
    if not np.isfinite(flight.motion.tilt_deg).any():
        return None
    figure, (axes,) = style.time_panels([1.6], flight.length_s)
    for column, (name, colour) in enumerate((("roll", PURPLE), ("pitch", BLUE))):
        values = flight.motion.tilt_deg[:, column]
        style.curve(axes, flight.motion.time_s, values, colour, name)
    axes.set_ylabel("tilt [°]")
    style.shade(axes, flight.states, _TROUBLE)
    style.legend(axes)
    return figure


def image_track(flight: Flight) -> Figure | None:
    """Draw the box in the image, centre and scale, and the tracker's confidence."""
    if not np.isfinite(boxes(flight.log.tracks)).any():
        return None
    figure, axes = style.time_panels([1.4, 1.1, 1.1], flight.length_s)
    draw_track_panels(axes, flight)
    return figure


def _truth_times(flight: Flight) -> Array:
    return np.array([sample.time_s - flight.start_s for sample in flight.truth], np.float64)
