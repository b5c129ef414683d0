"""What the pilot held, the gimbal did and the vehicle said of its health, over the flight."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from follower.flightlog import ControlRecord
from follower.report import style
from follower.report.flight import Flight
from follower.report.series import Array, control_times
from follower.report.style import BLUE, GREEN, INK, ORANGE, PURPLE, SKY

_CHANNELS = 8
_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, SKY, INK, BLUE, ORANGE)
_REJECTED = 1.0
_UP = 0.6

Controls = Sequence[ControlRecord]
Draw = Callable[[Axes, Array, Controls], None]


def pilot_and_vehicle(flight: Flight) -> Figure | None:
    """Draw a panel for each of them that the recording knows; None if it knows none."""
    controls = flight.log.controls
    panels = [(name, draw) for name, knows, draw in _PANELS if any(map(knows, controls))]
    if not panels:
        return None
    figure, axes = style.time_panels([1.1] * len(panels), flight.length_s)
    time = control_times(controls, flight.start_s)
    for panel, (name, draw) in zip(axes, panels, strict=True):
        draw(panel, time, controls)
        panel.set_ylabel(name)
        style.legend(panel)
    return figure


def channels(controls: Controls) -> Array:
    """Return the transmitter's first eight channels in microseconds, (N, 8); NaN where unheard."""
    rows = [
        [_number(None if r.vehicle.rc is None else r.vehicle.rc.pulse_us(1 + n)) for n in range(8)]
        for r in controls
    ]
    return np.array(rows, np.float64).reshape(-1, _CHANNELS)


def gimbal_angles(controls: Controls) -> Array:
    """Return the gimbal's (yaw, pitch) in degrees as its own message gives them, (N, 2)."""
    held = [record.vehicle.gimbal for record in controls]
    rows = [
        (math.nan, math.nan) if g is None else (g.attitude.yaw_rad, g.attitude.pitch_rad)
        for g in held
    ]
    return np.degrees(np.array(rows, np.float64).reshape(-1, 2))


def health(controls: Controls) -> Array:
    """Return (battery left in percent, the estimator's worst test ratio), (N, 2).

    What was told holds until it is told anew.
    """
    battery, ratio, rows = math.nan, math.nan, []
    for record in controls:
        told = record.health
        if told is not None and told.sensors is not None:
            battery = 100 * _number(told.sensors.battery_share)
        if told is not None and told.estimator is not None:
            ratio = max(told.estimator.ratios.values())
        rows.append((battery, ratio))
    return np.array(rows, np.float64).reshape(-1, 2)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _draw_channels(axes: Axes, time: Array, controls: Controls) -> None:
    for number, pulses in enumerate(channels(controls).T):
        style.curve(axes, time, pulses, _COLOURS[number], str(number + 1), width=0.9)


def _draw_consent(axes: Axes, time: Array, controls: Controls) -> None:
    curves = (
        ("consent stands", BLUE, "consent_given"),
        ("mode allows", GREEN, "mode_allows"),
        ("sticks moved", ORANGE, "sticks_moved"),
    )
    for number, (name, colour, field) in enumerate(curves):
        known = [r.situation for r in controls]
        values = [math.nan if s is None else _UP * getattr(s, field) + number for s in known]
        style.curve(axes, time, np.array(values, np.float64), colour, name, width=1.1)
    rows = range(len(curves))
    axes.set_yticks([row + up for row in rows for up in (0, _UP)], ["no", "yes"] * len(curves))
    axes.set_ylim(-0.2, len(curves) - 0.1)


def _draw_gimbal(axes: Axes, time: Array, controls: Controls) -> None:
    yaw, pitch = gimbal_angles(controls).T
    style.curve(axes, time, yaw, BLUE, "yaw", width=0.9)
    style.curve(axes, time, pitch, ORANGE, "pitch", width=0.9)


def _draw_battery(axes: Axes, time: Array, controls: Controls) -> None:
    style.curve(axes, time, health(controls)[:, 0], GREEN, "battery left", width=1.1)
    axes.set_ylim(0, 105)


def _draw_estimator(axes: Axes, time: Array, controls: Controls) -> None:
    style.curve(axes, time, health(controls)[:, 1], PURPLE, "worst test ratio", width=1.1)
    style.level(axes, _REJECTED, "rejected")
    axes.set_ylim(bottom=0)


def _has_battery(record: ControlRecord) -> bool:
    told = record.health
    return told is not None and told.sensors is not None and told.sensors.battery_share is not None


def _has_ratios(record: ControlRecord) -> bool:
    return record.health is not None and record.health.estimator is not None


_PANELS: tuple[tuple[str, Callable[[ControlRecord], bool], Draw], ...] = (
    ("channels [µs]", lambda record: record.vehicle.rc is not None, _draw_channels),
    ("", lambda record: record.situation is not None, _draw_consent),
    ("gimbal [°]", lambda record: record.vehicle.gimbal is not None, _draw_gimbal),
    ("battery [%]", _has_battery, _draw_battery),
    ("estimator", _has_ratios, _draw_estimator),
)
