"""The command line: `follower --help`."""

from __future__ import annotations

import sys
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from follower.calibration.command import EPILOG as CALIBRATE_EPILOG
from follower.calibration.command import calibrate_command
from follower.campaign.command import EPILOG as CAMPAIGN_EPILOG
from follower.campaign.command import campaign_command
from follower.command_options import Cockpit, Config, Out, Overrides, Video
from follower.configs import scenario_files
from follower.evaluate_command import EPILOG as EVALUATE_EPILOG
from follower.evaluate_command import evaluate_command
from follower.excite.command import EPILOG as EXCITE_EPILOG
from follower.excite.command import excite_command
from follower.faults.command import EPILOG as FAULTS_EPILOG
from follower.faults.command import faults_command, list_faults
from follower.fly_command import EPILOG as FLY_EPILOG
from follower.fly_command import fly_command
from follower.identify.command import EPILOG as IDENTIFY_EPILOG
from follower.identify.command import identify_command
from follower.import_command import EPILOG as IMPORT_EPILOG
from follower.import_command import import_command
from follower.inspect_command import EPILOG as INSPECT_EPILOG
from follower.inspect_command import inspect_command
from follower.models_command import models_app
from follower.preflight_command import EPILOG as PREFLIGHT_EPILOG
from follower.preflight_command import preflight_command
from follower.replay_command import EPILOG as REPLAY_EPILOG
from follower.replay_command import replay_command
from follower.track_command import EPILOG, track_command
from follower.training.command import train_app
from follower.training.re3.command import EXPORT_EPILOG, export_command
from follower.tune.command import EPILOG as TUNE_EPILOG
from follower.tune.command import tune_command
from follower_control.strict_yaml import SettingsError

DEFAULT_CONNECTION = "udpin:127.0.0.1:14540"
SUCCESS, FAILED, UNUSABLE, INTERRUPTED = 0, 1, 2, 130

_DEMO_EPILOG = """
**Examples**

`follower demo` – in real time, with MAVLink over UDP; wants two free cores

`follower demo --lockstep --seed 3` – on a simulated clock, however busy the computer is

`follower demo --autopilot ardupilot --set servo.distance_m=18` – another vehicle, another wish

`follower demo --lockstep --set detector=null` – the motion tracker alone: it does not find the car
"""
_SIM_EPILOG = """
**Examples**

`follower scenarios` – what there is; copy a file of configs/scenarios for one of your own

`follower sim walker --lockstep` – the same setpoints each time

`follower sim my.yaml --config mine.yaml --seed 5` – your own scenario and settings

`follower sim pursue-car --lockstep --vision truth+noise --scene wind.mean_m_s=8` – no pixels, fast

`follower sim winding --lockstep --fault frames-black@30:2` – what does it do when something breaks?

`follower sim winding --cockpit` – you choose the target and stop it, on a web page

`follower sim winding --autopilot external --connect udpin:0.0.0.0:14540` – PX4 or ArduPilot SITL

Ctrl-C holds, lets go and leaves a complete report. Exit code 0: the scenario's limits were kept; 1:
they were not; 2: an option cannot be used; 130: ended by Ctrl-C.
"""
_SETTINGS_EPILOG = """
**Examples**

`follower settings` – all there are; write into a file only what you change: it lies over a
scenario's own settings

`follower settings --config mine.yaml --set envelope.max_speed_m_s=5` – what comes of both

Units stand in the names: `_m` metres, `_s` seconds, `_m_s` metres a second, `_deg` degrees.
"""

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
    help=(
        "Follow a target seen by a drone's camera: a tracker finds it in the pixels, a Kalman "
        "filter and a PID visual servo turn its box into velocity setpoints, MAVLink carries them "
        "to PX4 (OFFBOARD) or ArduPilot (GUIDED).\n\n"
        "Start with **follower demo**."
    ),
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"follower {version('drone-target-follower')}")
        raise typer.Exit


@app.callback()
def _start(
    _version: Annotated[
        bool,
        typer.Option(
            "--version", help="Say which version this is.", callback=_show_version, is_eager=True
        ),
    ] = False,
) -> None:
    pass


app.command("fly", epilog=FLY_EPILOG)(fly_command)
app.command("preflight", epilog=PREFLIGHT_EPILOG)(preflight_command)
app.command("track", epilog=EPILOG)(track_command)
app.command("replay", epilog=REPLAY_EPILOG)(replay_command)
app.command("evaluate", epilog=EVALUATE_EPILOG)(evaluate_command)
app.command("campaign", epilog=CAMPAIGN_EPILOG)(campaign_command)
app.command("inspect", epilog=INSPECT_EPILOG)(inspect_command)
app.command("faults", epilog=FAULTS_EPILOG)(faults_command)
app.command("calibrate", epilog=CALIBRATE_EPILOG)(calibrate_command)
app.command("excite", epilog=EXCITE_EPILOG)(excite_command)
app.command("identify", epilog=IDENTIFY_EPILOG)(identify_command)
app.command("tune", epilog=TUNE_EPILOG)(tune_command)
app.command("import", epilog=IMPORT_EPILOG)(import_command)
app.add_typer(models_app, name="models", help="List, download and verify networks.")
app.add_typer(train_app, name="train")
app.command("export", epilog=EXPORT_EPILOG)(export_command)

Autopilot = Annotated[
    str,
    typer.Option(
        "--autopilot",
        help="Which autopilot to simulate: **px4** or **ardupilot**; **external** flies one that "
        "runs elsewhere, such as SITL, in our world.",
        metavar="px4|ardupilot|external",
    ),
]
Seed = Annotated[
    int | None, typer.Option(help="Seed of everything random; the scenario's own by default.")
]
LockstepFlag = Annotated[
    bool,
    typer.Option(
        "--lockstep",
        help="Run on a simulated clock instead of in real time: no threads, the same each time.",
    ),
]
Connect = Annotated[
    str,
    typer.Option(help="Where MAVLink is spoken in real time, as pymavlink writes it."),
]
LinkKind = Annotated[
    str | None,
    typer.Option(
        "--link",
        help="Which library speaks MAVLink: **pymavlink** (default) or **mavsdk**, in real time.",
        metavar="pymavlink|mavsdk",
    ),
]
Fault = Annotated[
    list[str] | None,
    typer.Option(
        "--fault",
        help="Make something go wrong; may be repeated. `--fault list` shows the catalogue.",
        metavar="NAME[@time[:duration]]",
    ),
]
Record = Annotated[
    bool, typer.Option(help="Record the flight, for `follower replay` and other programs.")
]


VisionBy = Annotated[
    str,
    typer.Option(
        "--vision",
        help="What sees: **pixels**, or **truth+noise**: a stand-in that is told where the target "
        "is, for quick studies of control.",
        metavar="pixels|truth+noise",
    ),
]
Scene = Annotated[
    list[str] | None,
    typer.Option(
        "--scene", metavar="KEY=VALUE", help="One key of the scenario, e.g. wind.mean_m_s=6."
    ),
]


@app.command(epilog=_DEMO_EPILOG)
def demo(
    autopilot: Autopilot = "px4",
    seed: Seed = None,
    lockstep: LockstepFlag = False,
    config: Config = None,
    overrides: Overrides = None,
    connect: Connect = DEFAULT_CONNECTION,
    out: Out = Path("runs"),
    video: Video = True,
    record: Record = True,
    link: LinkKind = None,
) -> None:
    """Fly a pursuit: the camera shakes, the car vanishes in a hall, and another one crosses.

    Fusion with the networks that come along finds it again. Takes under a minute in real
    time; on a computer that is too slow for it, frames come late and the end says so: then
    take --lockstep. Afterwards runs/demo holds the video, an HTML report and the score. The exit
    code is 0 if the pursuit succeeded, 1 if it failed.
    """
    sim("demo", autopilot, seed, lockstep, config, overrides, connect, out, video, record, link)


@app.command(epilog=_SIM_EPILOG)
def sim(
    scenario: Annotated[
        str, typer.Argument(help="A scenario file (YAML) or a name from `follower scenarios`.")
    ],
    autopilot: Autopilot = "px4",
    seed: Seed = None,
    lockstep: LockstepFlag = False,
    config: Config = None,
    overrides: Overrides = None,
    connect: Connect = DEFAULT_CONNECTION,
    out: Out = Path("runs"),
    video: Video = True,
    record: Record = True,
    link: LinkKind = None,
    faults: Fault = None,
    vision: VisionBy = "pixels",
    scene: Scene = None,
    cockpit: Cockpit = False,
) -> None:
    """Fly any scenario in the simulator and report on it."""
    from follower.sight import Sight
    from follower.simulate import simulate
    from follower.simulation_options import SimulationOptions

    if faults == ["list"]:
        list_faults()
        return

    options = SimulationOptions(
        scenario,
        autopilot,
        seed,
        lockstep,
        config,
        tuple(overrides or ()),
        out,
        video,
        connect,
        record,
        link,
        tuple(faults or ()),
        Sight.of(vision),
        tuple(scene or ()),
        cockpit,
    )
    raise typer.Exit(simulate(options))


@app.command()
def scenarios() -> None:
    """List the scenarios that come along."""
    from follower_sim.scenario_file import load_scenario

    for name, path in scenario_files().items():
        typer.echo(f"{name:18} {load_scenario(path).title}")


@app.command()
def trackers() -> None:
    """List the motion trackers that run here."""
    from follower_vision.trackers import tracker_names

    for name in tracker_names():
        typer.echo(name)


@app.command(epilog=_SETTINGS_EPILOG)
def settings(config: Config = None, overrides: Overrides = None) -> None:
    """Print all settings as they resolve, as YAML to copy and edit."""
    from follower.settings import load_settings

    typer.echo(load_settings(config, overrides=overrides or ()).to_yaml(), nl=False)


def main() -> NoReturn:
    """Run the command line; what the user can mend ends in one line and exit code 2."""
    try:
        app()
    except (ValueError, OSError) as error:
        if not isinstance(error, _user_errors()):
            raise
        typer.echo(f"follower: {_one_line(error)}", err=True)
        sys.exit(UNUSABLE)
    sys.exit(SUCCESS)


def _user_errors() -> tuple[type[Exception], ...]:
    """Return what a user can mend; any other error is ours and shows its traceback."""
    from follower.links.connection import ConnectionFailedError
    from follower_vision.framesource import SourceError
    from follower_vision.network import ModelError

    return SettingsError, ConnectionFailedError, SourceError, ModelError, OSError


def _one_line(error: ValueError | OSError) -> str:
    return " ".join(str(error).split())
