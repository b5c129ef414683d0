"""How old everything was when it was used, over the flight."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from follower.flightlog import ControlRecord, FlightLog
from follower.report import style
from follower.report.flight import Flight
from follower.report.series import Array, control_times
from follower.report.style import BLUE, GREEN, INK, ORANGE, PURPLE, SKY


def delays(flight: Flight) -> Figure | None:
    """Draw the frames' delays, and below the ages of what each control step knew."""
    if not (flight.log.tracks or flight.log.controls):
        return None
    figure, axes = style.time_panels([1.7, 1.5, 0.9], flight.length_s)
    _draw_frames(axes[0], flight)
    _draw_ages(axes[1], axes[2], flight)
    for panel, name in zip(axes, ("delay [ms]", "age [ms]", "age [ms]"), strict=True):
        panel.set_ylabel(name)
        panel.set_ylim(bottom=0)
        style.legend(panel)
    return figure


def first_uses(log: FlightLog) -> dict[float, float]:
    """Return capture time → time of the first control step that used the frame's answer."""
    uses: dict[float, float] = {}
    for record in log.controls:
        if record.track_captured_s is not None:
            uses.setdefault(record.track_captured_s, record.time_s)
    return uses


def telemetry_ages(controls: Sequence[ControlRecord]) -> Array:
    """Return the ages of attitude, position and heartbeat at each step in seconds, (N, 3)."""
    rows = [
        (
            record.vehicle.attitude_age_s(record.time_s),
            record.vehicle.position_age_s(record.time_s),
            record.vehicle.heartbeat_age_s(record.time_s),
        )
        for record in controls
    ]
    ages = np.array(rows, np.float64).reshape(-1, 3)
    ages[~np.isfinite(ages)] = np.nan
    return ages


def _draw_frames(axes: Axes, flight: Flight) -> None:
    tracks, uses = flight.log.tracks, first_uses(flight.log)
    time = np.array([record.captured_s - flight.start_s for record in tracks], np.float64)
    curves = (
        ("capture to vision", SKY, [record.received_s - record.captured_s for record in tracks]),
        ("capture to answer", BLUE, [record.done_s - record.captured_s for record in tracks]),
        (
            "capture to setpoint",
            ORANGE,
            [uses.get(record.captured_s, np.nan) - record.captured_s for record in tracks],
        ),
    )
    for name, colour, values in curves:
        style.curve(axes, time, 1e3 * np.array(values, np.float64), colour, name, width=0.9)


def _draw_ages(axes: Axes, heartbeat: Axes, flight: Flight) -> None:
    controls = flight.log.controls
    time, ages = control_times(controls, flight.start_s), 1e3 * telemetry_ages(controls)
    frames = [
        np.nan if record.track_captured_s is None else record.time_s - record.track_captured_s
        for record in controls
    ]
    style.curve(axes, time, 1e3 * np.array(frames, np.float64), ORANGE, "frame", width=0.7)
    style.curve(axes, time, ages[:, 1], GREEN, "position", width=0.7)
    style.curve(axes, time, ages[:, 0], PURPLE, "attitude", width=0.7)
    style.curve(heartbeat, time, ages[:, 2], INK, "heartbeat", width=0.7)
