"""The command `follower excite`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from follower.ui.terminal.cli_options import Config, Out, Overrides, typed_command

EPILOG = """
**Examples**

`follower excite` – in the simulator, in a few seconds; then `follower identify runs/excite`

`follower excite --autopilot ardupilot --wind 4 --pattern multisine` – with gusts, all tones at once

`follower excite --connect udpin:0.0.0.0:14540 -c my.yaml --forward 1.5` – a real vehicle, or SITL

**With a real vehicle**

1. The pilot takes off, climbs to a height from which 3 m up and down are free, and hovers with
about 10 m of room on all sides. Nothing moves: the pilot's mode is the consent.

2. The pilot switches to OFFBOARD (PX4) or GUIDED (ArduPilot): the pattern begins, forward and back,
right and left, up and down, turning. It takes about 70 s. All limits of `envelope` hold.

3. The pilot takes any other mode, or Ctrl-C: it holds and releases. After the pattern it does so by
itself.

Exit code 0: all of it was flown; 1: it was asked to end early; 2: an option cannot be used; 3: the
pilot took the vehicle back; 4: something failed.
"""

_SIZE = "How large"


def excite_command(
    connect: Annotated[
        str | None,
        typer.Option(
            metavar="udpin:HOST:PORT|tcp:HOST:PORT|DEVICE:BAUD",
            help="Where an autopilot speaks MAVLink; without it, one is simulated.",
        ),
    ] = None,
    autopilot: Annotated[
        str, typer.Option(metavar="px4|ardupilot", help="Which autopilot to simulate.")
    ] = "px4",
    pattern: Annotated[
        str, typer.Option(metavar="steps|multisine", help="Steps there and back, or many tones.")
    ] = "steps",
    forward: Annotated[
        float, typer.Option(help="Largest velocity, m/s; 0: none.", rich_help_panel=_SIZE)
    ] = 2.0,
    right: Annotated[float, typer.Option(help="Likewise.", rich_help_panel=_SIZE)] = 2.0,
    vertical: Annotated[float, typer.Option(help="Likewise.", rich_help_panel=_SIZE)] = 0.8,
    yaw: Annotated[float, typer.Option(help="Turning, deg/s.", rich_help_panel=_SIZE)] = 30.0,
    wind: Annotated[
        float, typer.Option(min=0, max=20, help="Simulated wind with gusts, m/s.")
    ] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the simulated gusts.")] = 0,
    config: Config = None,
    overrides: Overrides = None,
    out: Out = Path("runs"),
) -> None:
    """Fly a safe pattern from which `follower identify` learns how the vehicle responds.

    Doublets on each axis, through the same supervisor, envelope, link and recorder as a pursuit:
    the pilot's mode is the consent, and it ends in a hold.
    """
    from follower.tuning.excite.pattern import ExcitationSettings, PatternKind
    from follower.tuning.excite.run import FLAVOURS, ExcitationRun, excite
    from follower_control.common.strict_config import SettingsError

    if pattern not in list(PatternKind):
        raise SettingsError(f"--pattern {pattern}: choose {' or '.join(PatternKind)}")
    try:
        chosen = ExcitationSettings(PatternKind(pattern), forward, right, vertical, yaw)
    except ValueError as error:
        raise SettingsError(str(error)) from None
    if autopilot not in FLAVOURS:
        raise SettingsError(f"--autopilot {autopilot}: choose {' or '.join(FLAVOURS)}")
    run = ExcitationRun(chosen, connect, autopilot, out, wind, seed, typed_command())
    raise typer.Exit(excite(run, config, overrides or ()))
