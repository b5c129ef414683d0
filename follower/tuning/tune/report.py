"""Plots of a loop: Bode, Nyquist, responses, sensitivity; now and after."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from follower.report import style
from follower.report.style import BLUE, GREEN, MUTED, ORANGE, PALE, PURPLE, RED, SKY, Colour
from follower.tune.analysis import AxisAnalysis
from follower_control.tuning.axis_loop import AxisLoop
from follower_control.tuning.margins import frequencies

_GRID = frequencies(0.03, 30.0)
_OTHERS = (RED, PURPLE, GREEN, SKY)
MOST_DRAWN = len(_OTHERS)
"""How many what-ifs are drawn."""
_LONGEST_S = 40.0


def bode(one: AxisAnalysis) -> Figure:
    """Draw gain and phase of the open loop, with crossover and margins marked."""
    figure, (gain, phase) = _panels(2, 1, 4.6)
    for name, loop, colour in curves(one):
        response = loop.open_loop(_GRID)
        angle = np.degrees(np.unwrap(np.angle(response)))
        angle -= 360 * round((angle[0] + 90) / 360)
        gain.loglog(_GRID, np.abs(response), color=colour.light, label=name)
        phase.semilogx(_GRID, angle, color=colour.light)
        _mark(gain, phase, loop, colour)
    gain.axhline(1.0, color=MUTED.light, lw=0.9, ls="--")
    phase.axhline(-180.0, color=MUTED.light, lw=0.9, ls="--")
    gain.set_ylim(0.01, 100)
    phase.set_ylim(-400, 0)
    phase.set_yticks([-360, -270, -180, -90, 0])
    gain.set_ylabel("gain")
    phase.set_ylabel("phase [deg]")
    phase.set_xlabel("frequency [rad/s]")
    style.legend(gain)
    return figure


def nyquist(one: AxisAnalysis) -> Figure:
    """Draw the open loop in the complex plane, with the disc that Ms keeps it out of."""
    figure, (plane,) = _panels(1, 1, 4.0)
    disc = Circle((-1, 0), 1 / one.max_sensitivity, facecolor=PALE.light, alpha=0.45, lw=0)
    plane.add_patch(disc)
    circle = np.exp(1j * np.linspace(0, 2 * np.pi, 200))
    plane.plot(circle.real, circle.imag, color=MUTED.light, lw=0.8, ls=":")
    for name, loop, colour in curves(one):
        response = loop.open_loop(_GRID)
        plane.plot(response.real, response.imag, color=colour.light, label=name)
    plane.plot([-1], [0], marker="+", color=RED.light, ms=11, mew=2)
    plane.set_xlim(-2.4, 1.2)
    plane.set_ylim(-1.9, 1.2)
    plane.set_aspect("equal", adjustable="datalim")
    plane.set_xlabel("real part")
    plane.set_ylabel("imaginary part")
    style.legend(plane)
    return figure


def responses(one: AxisAnalysis) -> Figure:
    """Draw the answers to a new wish and to a target that begins to move."""
    figure, (step, pushed) = _panels(1, 2, 2.6)
    stable = [loop.bandwidth_rad_s() for _, loop, _ in curves(one) if loop.is_stable()]
    until_s = min(_LONGEST_S, max(4.0, 14.0 / min(stable, default=math.inf)))
    for name, loop, colour in curves(one):
        if not loop.is_stable():
            step.plot([], [], color=colour.light, label=f"{name}: unstable")
            continue
        step.plot(*loop.step_response(until_s), color=colour.light, label=name)
        pushed.plot(*loop.disturbance_response(until_s), color=colour.light)
    style.level(step, 1.0)
    style.level(pushed, 0.0)
    step.set_ylabel("reached")
    pushed.set_ylabel(f"error [{one.now.unit}]")
    for panel in (step, pushed):
        panel.set_xlabel("time [s]")
        panel.set_xlim(0, until_s)
    # Above both panels: of one of them it would take the other's room.
    names = step.get_legend_handles_labels()
    figure.legend(*names, loc="outside upper left", ncols=len(names[0]), columnspacing=1.4)
    return figure


def sensitivities(one: AxisAnalysis) -> Figure:
    """Draw the sensitivity over frequency."""
    figure, (panel,) = _panels(1, 1, 2.4)
    for name, loop, colour in curves(one):
        panel.loglog(_GRID, np.abs(loop.sensitivity(_GRID)), color=colour.light, label=name)
    panel.axhline(one.max_sensitivity, color=MUTED.light, lw=0.9, ls="--")
    panel.set_ylim(0.02, 5)
    panel.set_ylabel("sensitivity")
    panel.set_xlabel("frequency [rad/s]")
    style.legend(panel)
    return figure


def curves(one: AxisAnalysis) -> Iterator[tuple[str, AxisLoop, Colour]]:
    """Yield what is drawn, with its name and colour."""
    yield "now", one.now, ORANGE
    if one.tuned is not None:
        yield "after", one.tuned.loop, BLUE
    for (words, loop), colour in zip(one.what_ifs, _OTHERS, strict=False):
        yield words, loop, colour


def _mark(gain: Axes, phase: Axes, loop: AxisLoop, colour: Colour) -> None:
    """Draw the margins as short vertical lines where they are read; an unstable loop has none."""
    if not loop.is_stable():
        return
    margins = loop.margins()
    if math.isfinite(margins.gain):
        ends = [1 / margins.gain, 1.0]
        gain.plot([margins.gain_at_rad_s] * 2, ends, color=colour.light, lw=2.4, alpha=0.5)
    if margins.crossover_rad_s > 0:
        ends = [-180.0, -180.0 + math.degrees(margins.phase_rad)]
        phase.plot([margins.crossover_rad_s] * 2, ends, color=colour.light, lw=2.4, alpha=0.5)


def _panels(rows: int, columns: int, height_in: float) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(style.WIDTH_IN, height_in), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    return figure, list(axes.ravel())
