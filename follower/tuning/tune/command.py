"""The command `follower tune`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from follower.ui.terminal.cli_options import Config, Out, Overrides, typed_command

EPILOG = """
**Examples**

`follower tune px4` – the simulated PX4 with the default settings

`follower tune runs/identify/vehicle.yaml -c my.yaml` – your vehicle, your settings; then
`follower fly -c runs/tune/tuned.yaml …`

`follower tune ardupilot --scenario winding --bandwidth azimuth=1.5 --ms 1.5` – slower, more robust

`follower tune px4 --what-if delay=0.15 --what-if dead_time=0.2 --what-if gain=2` – what do the
gains survive?

Writes tuned.yaml (your settings with the new gains, for `-c`) and tuning.html with Bode and Nyquist
plots, step and disturbance responses, now and after. Nothing else is changed. docs/how-to/tune.md
explains all of it from the beginning.
"""


def tune_command(
    vehicle: Annotated[
        str,
        typer.Argument(help="vehicle.yaml of `follower identify`, or **px4** or **ardupilot**."),
    ],
    bandwidth: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LOOP=RAD/S",
            help="How fast a loop (azimuth, elevation, range) is to be; without, as fast as is "
            "robust. May be repeated.",
        ),
    ] = None,
    ms: Annotated[
        float, typer.Option(help="Largest sensitivity: smaller is calmer. 1.4 to 2 is usual.")
    ] = 1.6,
    what_if: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE[,…]",
            help="Look at the gains under other circumstances: delay, stamp_error, dead_time (s), "
            "camera_rate (1/s), range (m), gain (a factor). May be repeated.",
        ),
    ] = None,
    scenario: Annotated[
        str | None, typer.Option(help="Take this scenario's settings for a beginning.")
    ] = None,
    elevation: Annotated[
        float | None, typer.Option(help="At which elevation the target is seen, degrees.")
    ] = None,
    config: Config = None,
    overrides: Overrides = None,
    out: Out = Path("runs"),
) -> None:
    """Find gains for the follow loops from a model of the vehicle, and show what they are worth."""
    from follower.tuning.tune.run import TuneOptions, tune_follower

    options = TuneOptions(
        vehicle,
        config,
        tuple(overrides or ()),
        scenario,
        tuple(bandwidth or ()),
        ms,
        tuple(what_if or ()),
        elevation,
        out,
        typed_command(),
    )
    raise typer.Exit(tune_follower(options))
