"""The report of a tuning: the loops now and after, and what they survive."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from follower.report import html, sections, style
from follower.report.loop_plots import MOST_DRAWN, bode, nyquist, responses, sensitivities
from follower.report.meta import ReportMeta
from follower.report.writer import write_whole
from follower.tune.analysis import AxisAnalysis
from follower.tune.run import HEAD, rows, what_if_rows
from follower_control.tuning.conditions import Conditions

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
    (
        "Sensitivity",
        sensitivities,
        "By what factor the loop shrinks (below 1) or enlarges (above 1) a disturbance of each "
        "frequency. The peak is Ms.",
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
    """Write the page and return its path; `remarks` are those of the vehicle's identification."""
    meta = ReportMeta(
        "Follow gains",
        f"at {conditions.range_m:g} m and {math.degrees(conditions.elevation_rad):.0f} degrees of "
        f"elevation, a target of {conditions.size_m:g} m",
        command,
        files=(("tuned.yaml", "the settings with the new gains, for `-c`"),),
    )
    with style.plot_style():
        return write_whole(path, sections.filled(meta, _parts(found, conditions, meta, remarks)))


def _parts(
    found: Sequence[AxisAnalysis],
    conditions: Conditions,
    meta: ReportMeta,
    remarks: Sequence[str],
) -> list[str]:
    said = [f"{one.axis}: {one.tuned.because}" for one in found if one.tuned is not None]
    said += [f"The vehicle's identification said: {remark}" for remark in remarks]
    others = what_if_rows(found)
    return [
        sections.verdict_box("", "What the gains end at", said),
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
            html.table(("Loop", "What if", *HEAD[5:]), others) if others else "",
            *([html.paragraph(_NOT_ALL)] if len(found[0].what_ifs) > MOST_DRAWN else []),
        ),
        *(_axis(one) for one in found),
        html.section("What was assumed", html.table(("What", "Value"), _assumed(conditions))),
        sections.about(meta),
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
        ("Age of the position", f"{1e3 * delays.position_s:.0f} ms"),
        ("Error of the frames' stamps", f"{1e3 * delays.stamp_error_s:.0f} ms"),
        ("How hard the vehicle is steered", f"{conditions.acceleration_m_s2:g} m/s²"),
    ]
