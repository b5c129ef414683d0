"""The command `follower sitl`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from follower.ui.terminal.cli_options import Config, Out, Overrides, Video

EPILOG = """
**Examples**

`follower sitl winding --arducopter ~/ardupilot/build/sitl/bin/arducopter` – your ArduCopter

`follower sitl winding orbit --px4 ~/PX4-Autopilot/build/px4_sitl_default` – your PX4 with SIH

`follower sitl all --repeat 3 --no-video` – every scenario, three times, on the programs that
ARDUCOPTER_SITL and PX4_SITL name

`follower sitl --random 20 --vision truth+noise --speedup 3` – drawn paths, winds and delays

`follower sitl winding --simulated ardupilot` – our simulated autopilot as a program, to try it out

`follower sitl winding --connect udpin:0.0.0.0:14540` – one that runs already

The autopilot runs in a folder of its own on free ports and is ended with the flight. runs/sitl
holds the report, and a folder for each flight with the autopilot's own log (.bin, .ulg) beside
ours. Exit code 0: every flight kept its scenario's limits; 1: not every one; 2: nothing could be
flown; 130: ended by Ctrl-C; that of `follower sim` for one flight alone. See docs/how-to/sitl.md.
"""


def sitl_command(
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(
            help="Scenario files (YAML), names from `follower scenarios`, or **all**: those "
            "that need no gimbal."
        ),
    ] = None,
    arducopter: Annotated[
        Path | None,
        typer.Option(
            metavar="PROGRAM",
            help="ArduPilot's build/sitl/bin/arducopter; $ARDUCOPTER_SITL if none is named.",
        ),
    ] = None,
    px4: Annotated[
        Path | None,
        typer.Option(
            metavar="BUILD_FOLDER",
            help="PX4's build/px4_sitl_default; $PX4_SITL if none is named.",
        ),
    ] = None,
    simulated: Annotated[
        str | None,
        typer.Option(metavar="px4|ardupilot", help="Our simulated autopilot in a process."),
    ] = None,
    connect: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="An autopilot that runs already, e.g. udpin:0.0.0.0:14540."
        ),
    ] = None,
    link: Annotated[
        str, typer.Option(metavar="pymavlink|mavsdk|both", help="Which library speaks MAVLink.")
    ] = "pymavlink",
    repeat: Annotated[int, typer.Option(min=1, help="How often each flight is flown.")] = 1,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Of the first of them; the scenario's own by default."),
    ] = None,
    random: Annotated[
        int,
        typer.Option(min=0, help="Fly so many scenes as the campaign standard draws them."),
    ] = 0,
    speedup: Annotated[
        float,
        typer.Option(
            min=0.1, max=20.0, help="Simulated seconds in a real one; says if that is too fast."
        ),
    ] = 1.0,
    params: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="The autopilot's parameters; by default the one in configs/sitl."
        ),
    ] = None,
    config: Config = None,
    overrides: Overrides = None,
    vision: Annotated[
        str, typer.Option(metavar="pixels|truth+noise", help="What sees; see `follower sim`.")
    ] = "pixels",
    scene: Annotated[
        list[str] | None,
        typer.Option("--scene", metavar="KEY=VALUE", help="One key of each scenario."),
    ] = None,
    video: Video = True,
    out: Out = Path("runs"),
) -> None:
    """Fly scenarios on your own ArduCopter or PX4 in software-in-the-loop, and report on it.

    Its program is started, armed, flown in our world by its own physics and its own estimator,
    and ended; the scenario's wind is given to its simulator.
    """
    from follower.apps.sitl.run import SitlMatrix, fly_matrix, programs
    from follower.simulation.options import VisionSource

    matrix = SitlMatrix(
        scenarios=tuple(scenarios or ()),
        programs=programs(arducopter, px4, simulated, connect),
        link=link,
        repeat=repeat,
        seed=seed,
        speedup=speedup,
        parameter_file=params,
        config=config,
        overrides=tuple(overrides or ()),
        vision=VisionSource.of(vision),
        scene=tuple(scene or ()),
        video=video,
        connect=connect,
        random=random,
    )
    raise typer.Exit(fly_matrix(matrix, out))
