"""The command `follower identify`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from follower.ui.terminal.cli_options import Out, typed_command

EPILOG = """
**Examples**

`follower excite` and then `follower identify runs/excite` – a simulated vehicle

`follower identify runs/excite-2 runs/fly` – an identification flight for the vehicle's answers, a
pursuit for the camera's delay and the target's size

`follower identify log_17.ulg` – PX4's own log of a flight with velocity setpoints

`follower identify data/autopilot_steps/px_*.csv` – steps recorded as CSV

Writes vehicle.yaml, which `follower tune` takes, and identification.html with what was recorded
beside what the model says. Read docs/how-to/tune.md first.
"""


def identify_command(
    flights: Annotated[
        list[Path],
        typer.Argument(
            help="Of one vehicle: folders of flights, PX4 logs (.ulg), CSV files of recorded steps."
        ),
    ],
    report: Annotated[bool, typer.Option(help="Write the report with its plots.")] = True,
    out: Out = Path("runs"),
) -> None:
    """Learn from recordings how a vehicle answers: delays, gains, time constants.

    Fits the velocity on each axis and the yaw rate (dead time, order one or two, gain, rate limit),
    the delay from camera to setpoint and the target's size; with 95 % intervals, and judged by a
    part of the recording that the fit never saw.
    """
    from follower.tuning.identify.run import identify

    identify(flights, out, report, typed_command())
