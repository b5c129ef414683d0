"""How punctual the loops were."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from follower.flightlog import FlightLog
from follower.report import style
from follower.report.series import Array
from follower.report.style import BLUE, INK, ORANGE, WIDTH_IN
from follower.scoring import setpoint_delays


@dataclass(frozen=True, slots=True)
class Timing:
    """One measured time over the flight.

    Attributes:
        name: what was measured.
        values_s: each measurement, seconds.
    """

    name: str
    values_s: Array

    def percentile_ms(self, percent: float) -> float:
        """Return a percentile in milliseconds.

        Raises:
            IndexError: nothing was measured.
        """
        return 1e3 * float(np.percentile(self.values_s, percent))


def timings(log: FlightLog) -> list[Timing]:
    """Return the four times that matter, those that were measured at all.

    On a simulated clock nothing is ever late: then there is no lateness to speak of.
    """
    late_s = [record.late_s for record in log.controls]
    rows = [
        ("control: lateness", late_s if any(late_s) else []),
        ("control: one step's work", [record.busy_s for record in log.controls]),
        ("vision: one frame's work", [record.busy_s for record in log.tracks]),
        ("capture to setpoint", setpoint_delays(log.controls)),
    ]
    return [Timing(name, np.array(values, np.float64)) for name, values in rows if values]


def histograms(log: FlightLog) -> Figure | None:
    """Draw the timings' histograms, counts on a logarithmic axis so that the tails show."""
    measured = timings(log)
    if not measured:
        return None
    figure = Figure(figsize=(WIDTH_IN, 4.6))
    grid = figure.add_gridspec(2, 2)
    grid.update(left=0.075, right=0.985, top=0.93, bottom=0.1, hspace=0.55, wspace=0.18)
    for number, timing in enumerate(measured):
        _draw(figure.add_subplot(grid[divmod(number, 2)]), timing)
    return figure


def _draw(axes: Axes, timing: Timing) -> None:
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
