"""What the pilot held, the gimbal did and the vehicle reported of its health, over the flight."""

import math
from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from follower.flight.log import ControlRecord, setpoint_delays
from follower.report import style
from follower.report.series import Array, LoggedFlight, control_times
from follower.report.style import BLUE, GREEN, INK, ORANGE, PURPLE, SKY

_CHANNELS = 8
_COLOURS = (BLUE, ORANGE, GREEN, PURPLE, SKY, INK, BLUE, ORANGE)
_REJECTED = 1.0
_UP = 0.6

Controls = Sequence[ControlRecord]
Draw = Callable[[Axes, Array, Controls], None]


def pilot_and_vehicle(flight: LoggedFlight) -> Figure | None:
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
    """Return the transmitter's first eight channels in microseconds, (N, 8); NaN if none came."""
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

    What was reported holds until it is reported anew.
    """
    battery, ratio, rows = math.nan, math.nan, []
    for record in controls:
        reported = record.health
        if reported is not None and reported.sensors is not None:
            battery = 100 * _number(reported.sensors.battery_share)
        if reported is not None and reported.estimator is not None:
            ratio = max(reported.estimator.ratios.values())
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


_PANELS: tuple[tuple[str, Callable[[ControlRecord], bool], Draw], ...] = (
    ("channels [µs]", lambda record: record.vehicle.rc is not None, _draw_channels),
    ("", lambda record: record.situation is not None, _draw_consent),
    ("gimbal [°]", lambda record: record.vehicle.gimbal is not None, _draw_gimbal),
    ("battery [%]", lambda record: np.isfinite(health([record])[0, 0]), _draw_battery),
    ("estimator", lambda record: np.isfinite(health([record])[0, 1]), _draw_estimator),
)


def delays(flight: LoggedFlight) -> Figure | None:
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


def _draw_frames(axes: Axes, flight: LoggedFlight) -> None:
    tracks, used_s = flight.log.tracks, setpoint_delays(flight.log.controls)
    time = np.array([record.captured_s - flight.start_s for record in tracks], np.float64)
    curves = (
        ("capture to vision", SKY, [record.received_s - record.captured_s for record in tracks]),
        ("capture to answer", BLUE, [record.done_s - record.captured_s for record in tracks]),
        (
            "capture to setpoint",
            ORANGE,
            [used_s.get(record.captured_s, np.nan) for record in tracks],
        ),
    )
    for name, colour, values in curves:
        style.curve(axes, time, 1e3 * np.array(values, np.float64), colour, name, width=0.9)


def _draw_ages(axes: Axes, heartbeat: Axes, flight: LoggedFlight) -> None:
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
