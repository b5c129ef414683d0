"""Draws the pictures of docs/explanation/tuning.md.

follower excite --autopilot px4 --out runs/tuning
python benchmarks/tuning_pictures.py runs/tuning/excite
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import command_line
from matplotlib.figure import Figure

from follower.report import style
from follower.settings.settings import load_settings
from follower.tuning.identify.readers import VehicleAxis
from follower.tuning.identify.result import axis_figure
from follower.tuning.identify.run import read_recording
from follower.tuning.tune.analysis import AxisAnalysis, analyse, conditions_of, parse_what_ifs
from follower.tuning.tune.report import bode, nyquist, responses
from follower.tuning.tune.run import find_vehicle
from follower_control.tuning.axes import Axis
from follower_control.tuning.fit import fit_response
from follower_control.tuning.synthesis import TuningGoal

PICTURES = Path(__file__).parents[1] / "docs" / "pictures"


def azimuth(what_ifs: list[str], tuned: bool = False) -> AxisAnalysis:
    """Return the azimuth loop with the default gains and under other circumstances."""
    settings, vehicle = load_settings(), find_vehicle("ardupilot")
    here = conditions_of(settings, vehicle, -20.0)
    wishes = {axis: TuningGoal() for axis in Axis} if tuned else None
    others = parse_what_ifs(what_ifs, here)
    found = analyse(settings, vehicle.model(), here, wishes, others)
    return next(one for one in found if one.axis is Axis.AZIMUTH)


def save(name: str, figure: Figure) -> None:
    """Write one picture."""
    style.save_png(figure, PICTURES / f"tuning-{name}.png")


def main() -> None:
    """Draw all of them."""
    parser = command_line.parser(__doc__)
    parser.add_argument("excite", type=Path, help="folder of a flight of `follower excite`")
    recording = read_recording(parser.parse_args().excite)
    forward = recording.axes[VehicleAxis.FORWARD]
    with style.plot_style():
        fit = fit_response(forward, VehicleAxis.FORWARD.least_excitation)
        save("identified", axis_figure(VehicleAxis.FORWARD, fit, forward))
        gains = azimuth(["gain=0.4", "gain=2", "gain=2.4"])
        save("gains", responses(gains))
        save("bode", bode(azimuth([], tuned=True)))
        save("nyquist", nyquist(azimuth([], tuned=True)))
        save("delays", responses(azimuth(["dead_time=0.1", "dead_time=0.3", "dead_time=0.6"])))
        alone = replace(azimuth([], tuned=True), what_ifs=())
        save("after", responses(alone))


if __name__ == "__main__":
    command_line.run(main)
