"""The report of a tuning: the loops now and after, and what they survive."""

import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from rich.table import Table

from follower.report import flight_page, html, style
from follower.report.series import ReportMeta
from follower.report.style import BLUE, GREEN, MUTED, ORANGE, PALE, PURPLE, RED, SKY, Colour
from follower.tuning.tune.analysis import AxisAnalysis
from follower_control.servo.pid import PidSettings
from follower_control.tuning.axis_loop import AxisLoop, Conditions
from follower_control.tuning.rational import frequencies
from follower_vision.disk import write_whole

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
    plane.set_aspect("equal", adjustable="box")
    plane.set_xlabel("real part")
    plane.set_ylabel("imaginary part")
    style.legend(plane)
    return figure


def responses(one: AxisAnalysis) -> Figure:
    """Draw the responses to a step of the reference and to a target that begins to move."""
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


WHAT_IF_HEAD = ("Loop", "What if", "Bandwidth", "Ms", "Gain m.", "Phase m.", "Delay m.")
HEAD = ("Loop", "Gains", "kp", "ki", "kd", *WHAT_IF_HEAD[2:])


def rows(found: Sequence[AxisAnalysis]) -> list[tuple[str, ...]]:
    """Return the table's rows: each axis now and, if it was tuned, after."""
    made = []
    for one in found:
        made.append((one.axis.value, "now", *_gains(one.gains), *worth(one.now)))
        if one.tuned is not None:
            made.append(("", "after", *_gains(one.tuned.gains), *worth(one.tuned.loop)))
    return made


def terminal_table(head: Sequence[str], body: Sequence[Sequence[str]]) -> Table:
    """Return a table of which nothing is cut on a terminal of 80 columns."""
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0), header_style="dim")
    for name in head:
        table.add_column(name, overflow="fold", no_wrap=name != "What if")
    for row in body:
        table.add_row(*row)
    return table


def what_if_rows(found: Sequence[AxisAnalysis]) -> list[tuple[str, ...]]:
    """Return its rows."""
    return [(one.axis.value, words, *worth(loop)) for one in found for words, loop in one.what_ifs]


def _gains(gains: PidSettings) -> tuple[str, str, str]:
    return f"{gains.kp:.3g}", f"{gains.ki:.3g}", f"{gains.kd:.3g}"


def worth(loop: AxisLoop) -> tuple[str, ...]:
    """Return bandwidth, Ms and the three margins, as text; an unstable loop has none."""
    if not loop.is_stable():
        return ("unstable", "–", "–", "–", "–")
    m = loop.margins()
    gain = "∞" if math.isinf(m.gain) else f"×{m.gain:.1f}"
    phase = "∞" if math.isinf(m.phase_rad) else f"{math.degrees(m.phase_rad):.0f}°"
    delay = "∞" if math.isinf(m.delay_s) else f"{m.delay_s:.2f} s"
    return f"{loop.bandwidth_rad_s():.2f} rad/s", f"{m.max_sensitivity:.2f}", gain, phase, delay


_WHAT = {
    "azimuth": "Azimuth: turning the nose to the target",
    "elevation": "Elevation: rising and sinking with the target",
    "range": "Range: keeping the distance",
}
_PLOTS: tuple[tuple[str, Callable[[AxisAnalysis], Figure], str], ...] = (
    (
        "Bode",
        bode,
        "The open loop: how strong (above) and how late (below) an error comes back at each "
        "frequency. Where the curve above crosses 1, the distance of the curve below from -180 "
        "degrees is the phase margin; where the one below crosses -180 degrees, the distance of "
        "the one above from 1 is the gain margin.",
    ),
    (
        "Nyquist",
        nyquist,
        "The same as one curve. It must not go round the cross at -1, and stays out of the disc "
        "into which it would come with a larger Ms than wanted.",
    ),
    (
        "Responses",
        responses,
        "Left: what is wanted jumps by one. Right: the target begins to move steadily, by one unit "
        "a second; drawn is the error that comes of it.",
    ),
)


_NOT_ALL = f"The plots show the first {MOST_DRAWN} of them."


def write_tuning(
    path: Path,
    found: Sequence[AxisAnalysis],
    conditions: Conditions,
    command: str,
    remarks: Sequence[str] = (),
) -> Path:
    """Write the page and return its path; `remarks` are what else is to be known, in sentences."""
    meta = ReportMeta(
        "Follow gains",
        f"at {conditions.range_m:g} m and {math.degrees(conditions.elevation_rad):.0f} degrees of "
        f"elevation, a target of {conditions.size_m:g} m",
        command,
        files=(("tuned.yaml", "the settings with the new gains, for `-c`"),),
    )
    with style.plot_style():
        return write_whole(path, flight_page.filled(meta, _parts(found, conditions, meta, remarks)))


def _parts(
    found: Sequence[AxisAnalysis],
    conditions: Conditions,
    meta: ReportMeta,
    remarks: Sequence[str],
) -> list[str]:
    lines = [f"{one.axis}: {one.tuned.because}" for one in found if one.tuned is not None]
    others = what_if_rows(found)
    return [
        flight_page.verdict_box("", "What limits the gains", [*lines, *remarks]),
        html.section(
            "Before and after",
            html.table(HEAD, rows(found), numbers=tuple(range(2, len(HEAD)))),
            html.paragraph(
                "The margins are those of more gain, more phase lag and more delay on the way to "
                "the vehicle; the smallest counts. Linear theory about steady following: no "
                "limits, no coupling between the axes."
            ),
        ),
        html.section(
            "What if",
            html.table(WHAT_IF_HEAD, others) if others else "",
            *([html.paragraph(_NOT_ALL)] if len(found[0].what_ifs) > MOST_DRAWN else []),
        ),
        *(_axis(one) for one in found),
        html.section("What was assumed", html.table(("What", "Value"), _assumed(conditions))),
        flight_page.about(meta),
    ]


def _axis(one: AxisAnalysis) -> str:
    drawn = []
    for name, draw, caption in _PLOTS:
        svg = style.to_svg(draw(one), f"{one.axis}{name.lower()}", f"{name} of {one.axis}")
        drawn.append(html.figure(svg, caption))
    return html.section(_WHAT[one.axis], *drawn)


def _assumed(conditions: Conditions) -> list[tuple[str, str]]:
    delays = conditions.delays
    return [
        ("From the camera's exposure to the setpoint", f"{1e3 * delays.camera_s:.0f} ms"),
        ("Between two frames", f"{1e3 * delays.frame_interval_s:.0f} ms"),
        ("Between two setpoints", f"{1e3 * delays.control_interval_s:.0f} ms"),
        ("Error of the frames' stamps", f"{1e3 * delays.stamp_error_s:.0f} ms"),
        ("How hard the vehicle is steered", f"{conditions.acceleration_m_s2:g} m/s²"),
    ]
