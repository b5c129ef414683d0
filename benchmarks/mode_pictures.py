"""Draws flights from above: paths, lines of sight, where the nose points.

For docs/reference/follow-modes.md.

    follower sim orbit --lockstep --no-video
    python benchmarks/mode_pictures.py runs/orbit --out docs/pictures
"""

from __future__ import annotations

import math
from pathlib import Path

import command_line
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from follower.flight.supervision.supervisor import SupervisorState
from follower.recording import RecordedFlight, open_flight
from follower_sim.kinematics import TruthSample

EVERY_S = 3.0
_VEHICLE, _TARGET, _SIGHT = "#0072b2", "#d55e00", "#98a2b0"
_WIDTH_IN, _DPI = 5.0, 80


def main() -> None:
    """Draw the flights that are named on the command line."""
    parser = command_line.parser(__doc__)
    parser.add_argument("flights", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/pictures"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for folder in options.flights:
        flight = open_flight(folder)
        name = flight.config.run.get("scenario", folder.name)
        picture = options.out / f"{name}.png"
        draw(flight, str(name)).savefig(picture, dpi=_DPI, bbox_inches="tight")
        print(f"{picture}: {picture.stat().st_size // 1024} KB")


def draw(flight: RecordedFlight, name: str) -> Figure:
    """Return the map of what happened from the first moment of following on."""
    following = [c.time_s for c in flight.log.controls if c.state is SupervisorState.FOLLOWING]
    if not following or not flight.truth:
        raise SystemExit(f"{flight.folder}: not a simulated flight that followed its target")
    truth = [t for t in flight.truth if following[0] <= t.time_s <= following[-1]]
    figure = Figure(figsize=(_WIDTH_IN, _WIDTH_IN))
    axes = figure.add_subplot()
    own = np.array([sample.vehicle.position_m[:2] for sample in truth])
    target = np.array([sample.target_position_m[:2] for sample in truth])
    axes.plot(target[:, 1], target[:, 0], color=_TARGET, label="target")
    axes.plot(own[:, 1], own[:, 0], color=_VEHICLE, label="drone")
    step = max(1, round(EVERY_S / (truth[1].time_s - truth[0].time_s)))
    for sample in truth[::step]:
        _draw_moment(axes, sample)
    axes.set_aspect("equal", "datalim")
    axes.set_xlabel("east, m")
    axes.set_ylabel("north, m")
    axes.grid(color="#e1e5ea")
    axes.set_axisbelow(True)
    axes.set_title(f"{name}: every {EVERY_S:.0f} s, the arrow is the nose", fontsize=9)
    axes.legend(fontsize=8)
    return figure


def _draw_moment(axes: Axes, sample: TruthSample) -> None:
    north, east, _ = sample.vehicle.position_m
    target_north, target_east, _ = sample.target_position_m
    axes.plot([east, target_east], [north, target_north], color=_SIGHT, linewidth=0.6)
    axes.plot(target_east, target_north, "o", color=_TARGET, markersize=4)
    axes.plot(east, north, "o", color=_VEHICLE, markersize=4)
    yaw = sample.vehicle.yaw_rad
    axes.annotate(
        "",
        (east + 2.5 * math.sin(yaw), north + 2.5 * math.cos(yaw)),
        (east, north),
        arrowprops={"arrowstyle": "->", "color": _VEHICLE, "linewidth": 1.2},
    )


if __name__ == "__main__":
    command_line.run(main)
