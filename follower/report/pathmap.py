"""The map of the paths flown and driven: north up, equal axes."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from follower.report.flight import Flight
from follower.report.series import Array, estimated_ranges, estimated_target
from follower.report.style import BLUE, INK, MUTED, ORANGE, PAPER, Colour

_STEPS_S = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600)
_POINTS = 2000
"""At most this many points of a path are drawn."""
_ROOM_FOR_FOUR_IN = 5.5
_WILD = 4.0
"""Places this many times as far away as usual are not drawn."""


def path_map(flight: Flight) -> Figure | None:
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
        _draw_sights(axes, time, own, target, ticks)
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


def _guessed_target(flight: Flight) -> Array:
    """Return where the target seemed to be, (N, 2), where nobody knows the truth."""
    if flight.truth:
        return np.empty((0, 2))
    controls = flight.log.controls
    ranges = estimated_ranges(controls, flight.target_size_m)
    places = estimated_target(controls, flight.target_size_m)
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
    for row, marker, what in ((0, "o", "start"), (-1, "s", "end")):
        axes.plot(
            path[row, 1],
            path[row, 0],
            marker,
            color=colour.light,
            markeredgecolor=PAPER.light,
            markersize=8,
            zorder=5,
            label=f"{what}" if colour is BLUE else None,
        )


def _draw_sights(axes: Axes, time: Array, own: Array, target: Array, ticks: list[float]) -> None:
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
        axes.annotate(
            f"{tick:.0f} s",
            (east, north),
            xytext=(4, 4),
            textcoords="offset points",
            fontsize=7.5,
            color=INK.light,
            zorder=6,
        )


def _ticks(time: Array) -> list[float]:
    """Return about eight round times within the flight."""
    first, last = float(time[0]), float(time[-1])
    step = next((s for s in _STEPS_S if (last - first) / s <= 9), _STEPS_S[-1])
    start = math.ceil(first / step) * step
    return [float(tick) for tick in np.arange(start, last - 0.2 * step, step)]
