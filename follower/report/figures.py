"""The report's figures. Each takes a flight and returns a drawing, or None if it is empty."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from follower.flight.log import ControlRecord, FlightLog
from follower.report import style
from follower.report.series import (
    Array,
    LoggedFlight,
    Span,
    Timing,
    believed_ranges,
    boxes,
    control_times,
    directions,
    estimated_target,
    setpoints,
    timings,
)
from follower.report.style import (
    BLUE,
    GREEN,
    INK,
    MUTED,
    ORANGE,
    PAPER,
    PURPLE,
    SKY,
    YELLOW,
    Colour,
)
from follower_sim.scoring.score import APPROACH_RANGE, PursuitGoal, line_of_sight_errors

_BANDS = 0.3
"""Height of a row of state bands, inches."""
_TARGETS = (SKY, ORANGE, PURPLE, YELLOW)
"""The first target's colour, the second's, ..., as in the video."""
_TROUBLE = {name: style.STATES[name] for name in ("coasting", "searching", "holding", "released")}
_CHARACTER_IN = 0.068
"""About how wide a character of a small label is."""
_STEPS_S = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600)
_POINTS = 2000
"""At most this many points of a path are drawn."""
_ROOM_FOR_FOUR_IN = 5.5
_WILD = 4.0
"""Places this many times as far away as usual are not drawn."""


def write_track_plot(path: Path, log: FlightLog) -> None:
    """Write a PNG: box centre, scale, confidence and states, and below the setpoints.

    Raises:
        OSError: it cannot be written.
    """
    with style.plot_style():
        style.save_png(track_figure(LoggedFlight(log)), path)


def write_targets_plot(path: Path, logs: Sequence[FlightLog]) -> None:
    """Write a PNG of several targets in one: states, box centres, scales and confidences.

    Raises:
        OSError: it cannot be written.
    """
    with style.plot_style():
        style.save_png(targets_figure([LoggedFlight(log) for log in logs]), path)


def track_figure(flight: LoggedFlight) -> Figure:
    """Draw the plot, within `style.plot_style`; a log without anything gives empty panels."""
    setpoint_heights = [1.2, 1.2] if flight.log.controls else []
    heights = [_BANDS, 1.3, 1.0, 1.0, *setpoint_heights]
    figure, axes = style.time_panels(heights, flight.length_s)
    _draw_bands(axes[0], [("target", flight.seen)])
    draw_track_panels(axes[1:4], flight)
    if setpoint_heights:
        _draw_setpoints(axes[4], axes[5], flight)
    return figure


def targets_figure(flights: Sequence[LoggedFlight]) -> Figure:
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
    style.legend(axes, [Patch(facecolor=style.TRACK_STATES[n].light, label=n) for n in occurring])


def draw_track_panels(axes: list[Axes], flight: LoggedFlight) -> None:
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


def _draw_setpoints(velocity: Axes, yaw_rate: Axes, flight: LoggedFlight) -> None:
    controls = flight.log.controls
    time, allowed = control_times(controls, flight.start_s), _sent_setpoints(controls, "allowed")
    for column, (name, colour) in enumerate((("forward", BLUE), ("right", ORANGE), ("up", GREEN))):
        style.curve(velocity, time, allowed[:, column], colour, name)
    style.curve(yaw_rate, time, allowed[:, 3], INK)
    velocity.set_ylabel("setpoint [m/s]")
    yaw_rate.set_ylabel("yaw rate [°/s]")
    style.legend(velocity)


def states(flight: LoggedFlight) -> Figure | None:
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


def _draw_band(axes: Axes, spans: list[Span], row: int, flight: LoggedFlight) -> None:
    least_s = flight.length_s / 600
    bars = [(span.start_s, max(span.length_s, least_s)) for span in spans]
    axes.broken_barh(bars, (row - 0.32, 0.64), facecolor=style.STATES[spans[0].state].light)
    width_in = style.WIDTH_IN * 0.9
    nexts = [*(span.start_s for span in spans[1:]), flight.length_s]
    for span, next_s in zip(spans, nexts, strict=True):
        need_s = len(span.reason) * _CHARACTER_IN * max(flight.length_s, 1e-3) / width_in
        room_right = next_s - span.end_s
        if room_right > need_s:
            place = max(span.end_s, span.start_s + least_s), row
            _annotate(axes, span.reason, place, MUTED, va="center")


def line_of_sight(flight: LoggedFlight) -> Figure | None:
    """Draw azimuth and elevation of the target from the heading: truth and estimate."""
    controls = flight.log.controls
    if not flight.truth and all(record.estimate is None for record in controls):
        return None
    heights = [1.5, 1.5, 1.1] if flight.truth and flight.goal else [1.5, 1.5]
    figure, axes = style.time_panels(heights, flight.length_s)
    time, estimate = control_times(controls, flight.start_s), directions(controls)
    truth = np.degrees([(s.azimuth_rad, s.elevation_rad) for s in flight.truth]).reshape(-1, 2)
    wanted_rad = flight.goal.elevation_rad if flight.goal else None
    wanted = (0.0, None if wanted_rad is None else math.degrees(wanted_rad))
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


def _draw_error(axes: Axes, flight: LoggedFlight, goal: PursuitGoal) -> None:
    angle = np.degrees(line_of_sight_errors(flight.truth, goal))
    style.curve(axes, _truth_times(flight), angle, BLUE, "true angle to the wanted direction")
    axes.set_ylabel("error [°]")
    axes.set_ylim(bottom=0)
    _mark_approach(axes, flight)
    style.shade(axes, flight.states, _TROUBLE)
    style.legend(axes)


def distance(flight: LoggedFlight) -> Figure | None:
    """Draw range and height: true, estimated and wanted."""
    controls = flight.log.controls
    time = control_times(controls, flight.start_s)
    ranges = believed_ranges(controls, flight.servo)
    height = flight.motion.position_m[:, 2]
    if not (flight.truth or np.isfinite(ranges).any() or np.isfinite(height).any()):
        return None
    figure, axes = style.time_panels([1.9, 1.1], flight.length_s)
    _draw_wanted_range(axes[0], flight)
    true = np.array([sample.range_m for sample in flight.truth], np.float64)
    style.curve(axes[0], time, ranges, ORANGE, "as believed", width=2.4)
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


def _draw_wanted_range(axes: Axes, flight: LoggedFlight) -> None:
    wanted_m = flight.goal.distance_m if flight.goal else None
    if wanted_m is None:
        return
    low, high = (1 - APPROACH_RANGE) * wanted_m, (1 + APPROACH_RANGE) * wanted_m
    axes.axhspan(low, high, facecolor=GREEN.light, alpha=0.12, linewidth=0)
    style.level(axes, wanted_m, "wanted, ± 15 %")


def _mark_approach(axes: Axes, flight: LoggedFlight) -> None:
    if flight.approached_s is not None:
        axes.axvline(flight.approached_s, color=MUTED.light, linewidth=1, linestyle=(0, (1, 2)))
        place, within = (flight.approached_s, 0.93), ("data", "axes fraction")
        _annotate(axes, "scored from here", place, MUTED, xycoords=within, va="top")


def _top(true: Array, estimated: Array) -> float | None:
    """Return the axis' upper end: a wild estimate of a far box must not flatten the truth."""
    values = true if len(true) else estimated[np.isfinite(estimated)]
    return 1.15 * float(np.percentile(values, 99.5)) + 1 if len(values) else None


def velocities(flight: LoggedFlight) -> Figure | None:
    """Draw each axis' velocity and the yaw rate: asked, allowed and flown."""
    controls = flight.log.controls
    if not (any(r.sent for r in controls) or np.isfinite(flight.motion.velocity).any()):
        return None
    figure, axes = style.time_panels([1.35] * 4, flight.length_s)
    time = control_times(controls, flight.start_s)
    asked, allowed = _sent_setpoints(controls, "asked"), _sent_setpoints(controls, "allowed")
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


def _sent_setpoints(controls: Sequence[ControlRecord], name: str) -> Array:
    rows = setpoints(controls, name)
    rows[[not record.sent for record in controls]] = math.nan
    return rows


def tilt(flight: LoggedFlight) -> Figure | None:
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


def image_track(flight: LoggedFlight) -> Figure | None:
    """Draw the box in the image, centre and scale, and the tracker's confidence."""
    if not np.isfinite(boxes(flight.log.tracks)).any():
        return None
    figure, axes = style.time_panels([1.4, 1.1, 1.1], flight.length_s)
    draw_track_panels(axes, flight)
    return figure


def timing_histograms(log: FlightLog) -> Figure | None:
    """Draw the timings' histograms, counts on a logarithmic axis so that the tails show."""
    measured = timings(log)
    if not measured:
        return None
    figure = Figure(figsize=(style.WIDTH_IN, 4.6))
    grid = figure.add_gridspec(2, 2)
    grid.update(left=0.075, right=0.985, top=0.93, bottom=0.1, hspace=0.55, wspace=0.18)
    for number, timing in enumerate(measured):
        _draw_histogram(figure.add_subplot(grid[divmod(number, 2)]), timing)
    return figure


def _draw_histogram(axes: Axes, timing: Timing) -> None:
    values_ms = 1e3 * timing.values_s
    top = max(float(values_ms.max()) * 1.02, 1e-3)
    axes.hist(
        values_ms,
        bins=np.linspace(min(0.0, float(values_ms.min())), top, 61).tolist(),
        color=BLUE.light,
        log=True,
    )
    for percent, colour, name in ((50, INK, "median"), (99, ORANGE, "p99")):
        value = timing.percentile_ms(percent)
        axes.axvline(value, color=colour.light, linewidth=1.3, label=f"{name} {value:.2f} ms")
    axes.set_xlabel(f"{timing.name} [ms]")
    axes.set_ylabel("number")
    axes.set_ylim(bottom=0.7)
    style.legend(axes)


def _truth_times(flight: LoggedFlight) -> Array:
    return np.array([sample.time_s - flight.start_s for sample in flight.truth], np.float64)


def path_map(flight: LoggedFlight) -> Figure | None:
    """Draw both paths from above, with lines of sight and times, or None if nothing is known."""
    time, own = flight.motion.time_s, flight.motion.position_m[:, :2]
    known = np.isfinite(own).all(axis=1)
    if not known.any():
        return None
    target = np.array([sample.target_position_m[:2] for sample in flight.truth]).reshape(-1, 2)
    guessed = _guessed_target(flight)
    figure, axes = _sheet(np.concatenate([own[known], target, guessed]))
    ticks = _ticks(time[known])
    if len(target):
        _join_paths(axes, time, own, target, ticks)
        _draw_path(axes, target, ORANGE, "target")
    if len(guessed):
        places = guessed[:: 1 + len(guessed) // _POINTS]
        label = "target, as estimated"
        axes.plot(places[:, 1], places[:, 0], ".", color=ORANGE.light, markersize=3, label=label)
    _draw_path(axes, own[known], BLUE, "vehicle")
    _draw_times(axes, time[known], own[known], ticks)
    columns = 4 if figure.get_figwidth() > _ROOM_FOR_FOUR_IN else 2
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=columns, borderaxespad=0.2)
    return figure


def _guessed_target(flight: LoggedFlight) -> Array:
    """Return where the target seemed to be, (N, 2), where nobody knows the truth."""
    if flight.truth:
        return np.empty((0, 2))
    controls = flight.log.controls
    ranges = believed_ranges(controls, flight.servo)
    places = estimated_target(controls, flight.servo)
    known = np.isfinite(places).all(axis=1)
    # A box that has shrunk to a few pixels would make a map of kilometres.
    near = ranges <= _WILD * np.median(ranges[known]) if known.any() else known
    return places[known & near]


def _sheet(points: Array) -> tuple[Figure, Axes]:
    """Return a sheet of about the paths' own shape, neither too slim nor too flat."""
    tall_m, wide_m = np.ptp(points, axis=0) + 10.0
    shape = min(max(float(wide_m / tall_m), 0.6), 2.0)
    height_in = min(6.0, 8.0 / shape)
    width_in = shape * height_in
    figure = Figure(figsize=(width_in + 0.9, height_in + 1.0))
    wide, tall = figure.get_size_inches()
    axes = figure.add_axes((0.7 / wide, 0.5 / tall, width_in / wide, height_in / tall))
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    return figure, axes


def _draw_path(axes: Axes, path: Array, colour: Colour, name: str) -> None:
    line = path[:: 1 + len(path) // _POINTS]
    axes.plot(line[:, 1], line[:, 0], color=colour.light, linewidth=1.8, label=name, zorder=3)
    for row, marker in ((0, "o"), (-1, "s")):
        axes.plot(
            path[row, 1],
            path[row, 0],
            marker,
            color=colour.light,
            markeredgecolor=PAPER.light,
            markersize=8,
            zorder=5,
        )


def _join_paths(axes: Axes, time: Array, own: Array, target: Array, ticks: list[float]) -> None:
    """Join the two paths by a thin line at each time tick."""
    for tick in ticks:
        row = int(np.searchsorted(time, tick))
        ends = np.array([own[row], target[row]])
        axes.plot(ends[:, 1], ends[:, 0], color=MUTED.light, linewidth=0.6, zorder=2)


def _draw_times(axes: Axes, time: Array, path: Array, ticks: list[float]) -> None:
    """Write the ticks' times beside the path, but not one on top of the other."""
    apart_m = 0.06 * float(np.ptp(path, axis=0).max())
    labelled = np.full(2, np.inf)
    for tick in ticks:
        north, east = place = path[int(np.searchsorted(time, tick))]
        axes.plot(east, north, ".", color=INK.light, markersize=5, zorder=4)
        if np.linalg.norm(place - labelled) < apart_m:
            continue
        labelled = place
        _annotate(axes, f"{tick:.0f} s", (east, north), INK, zorder=6)


def _annotate(
    axes: Axes, text: str, place: tuple[float, float], colour: Colour, **more: Any
) -> None:
    """Write small text a little to the right of a place."""
    more |= {"textcoords": "offset points", "fontsize": 8, "color": colour.light}
    axes.annotate(text, place, xytext=(4, 0), **more)


def _ticks(time: Array) -> list[float]:
    """Return about eight round times within the flight."""
    first, last = float(time[0]), float(time[-1])
    step = next((s for s in _STEPS_S if (last - first) / s <= 9), _STEPS_S[-1])
    start = math.ceil(first / step) * step
    return [float(tick) for tick in np.arange(start, last - 0.2 * step, step)]
