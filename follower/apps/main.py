"""The command line: `follower --help`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from follower.apps.bench import command as bench
from follower.apps.calibrate.command import calibrate_app
from follower.apps.doctor import command as doctor
from follower.apps.evaluate import command as evaluate
from follower.apps.fly import command as fly
from follower.apps.import_flight import command as import_flight
from follower.apps.models import models_app
from follower.apps.preflight import command as preflight
from follower.apps.replay import command as replay
from follower.apps.ros import command as ros
from follower.apps.service import service_app
from follower.apps.sitl import command as sitl
from follower.apps.track import command as track
from follower.settings.settings import scenario_files
from follower.simulation.campaign import command as campaign
from follower.simulation.fault_tests import command as fault_tests
from follower.training.command import EXPORT_EPILOG, export_command, train_app
from follower.tuning.excite import command as excite
from follower.tuning.identify import command as identify
from follower.tuning.tune import command as tune
from follower.ui.terminal.cli_options import Cockpit, Config, LinkKind, Out, Overrides, Video
from follower_control.common.strict_config import SettingsError

SUCCESS, FAILED, UNUSABLE, INTERRUPTED = 0, 1, 2, 130

_DEMO_EPILOG = """
**Examples**

`follower demo` – in real time, with MAVLink over UDP; wants two free cores

`follower demo --lockstep --seed 3` – on a simulated clock, however busy the computer is

`follower demo --autopilot ardupilot --set servo.distance_m=18` – another vehicle, another distance

`follower demo --lockstep --set detector=null` – without a detector
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

Ctrl-C holds, releases and leaves a complete report. Exit code 0: the scenario's limits were kept;
1: they were not; 2: an option cannot be used; 3: handed over to the pilot; 4: released because
something failed; 130: ended by Ctrl-C.
"""
_INSPECT_EPILOG = """
**Examples**

`follower inspect runs/fly` – writes runs/fly/inspection.html

`follower inspect runs/demo --out demo.html` – somewhere else

`follower inspect runs/demo --foxglove demo.mcap --rerun demo.rrd` – and for these viewers
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
    int | None,
    typer.Option(min=0, help="Seed of everything random; the scenario's own by default."),
]
LockstepFlag = Annotated[
    bool,
    typer.Option(
        "--lockstep",
        help="Run on a simulated clock instead of in real time: no threads, the same each time.",
    ),
]
Connect = Annotated[
    str | None,
    typer.Option(
        help="Where MAVLink is spoken in real time, as pymavlink writes it; udpin:127.0.0.1:14540 "
        "by default, or with a simulated autopilot any free port if that one is in use.",
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
        help="What sees: **pixels**, or **truth+noise**: a stand-in that is given "
        "the target's true box, for quick studies of control.",
        metavar="pixels|truth+noise",
    ),
]
Scene = Annotated[
    list[str] | None,
    typer.Option(
        "--scene", metavar="KEY=VALUE", help="One key of the scenario, e.g. wind.mean_m_s=6."
    ),
]


def demo(
    autopilot: Autopilot = "px4",
    seed: Seed = None,
    lockstep: LockstepFlag = False,
    config: Config = None,
    overrides: Overrides = None,
    connect: Connect = None,
    out: Out = Path("runs"),
    video: Video = True,
    record: Record = True,
    link: LinkKind = None,
) -> None:
    """Fly a pursuit: the camera shakes, the car vanishes in a hall, and another one crosses.

    Fusion with the networks that come along finds it again. Takes under a minute in real
    time. Where it fails because the computer is too slow, it is flown once more in --lockstep,
    into the next folder, for as long as it takes. Afterwards runs/demo holds the video, an HTML
    report and the score. The exit code is 0 if the pursuit succeeded, 1 if it failed; see
    docs/reference/supervisor.md.
    """
    from follower.flight.supervision.flight_end import RELEASED_FOR_SAFETY
    from follower.simulation.options import SimulationOptions
    from follower.simulation.run import simulate

    options = SimulationOptions(
        scenario="demo",
        autopilot=autopilot,
        seed=seed,
        lockstep=lockstep,
        config=config,
        overrides=tuple(overrides or ()),
        out=out,
        video=video,
        connect=connect,
        record=record,
        link=link,
    )
    result = simulate(options)
    ours = connect is None and link != "mavsdk"  # what can be flown in lockstep
    if result.exit_code in (FAILED, RELEASED_FOR_SAFETY) and result.too_slow and ours:
        typer.echo("This computer is too slow to fly that in real time. Once more in lockstep:")
        result = simulate(replace(options, lockstep=True))
    raise typer.Exit(result.exit_code)


def sim(
    scenario: Annotated[
        str, typer.Argument(help="A scenario file (YAML) or a name from `follower scenarios`.")
    ],
    autopilot: Autopilot = "px4",
    seed: Seed = None,
    lockstep: LockstepFlag = False,
    config: Config = None,
    overrides: Overrides = None,
    connect: Connect = None,
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
    from follower.simulation.options import SimulationOptions, VisionSource
    from follower.simulation.run import simulate

    if faults == ["list"]:
        fault_tests.list_faults()
        return

    options = SimulationOptions(
        scenario=scenario,
        autopilot=autopilot,
        seed=seed,
        lockstep=lockstep,
        config=config,
        overrides=tuple(overrides or ()),
        out=out,
        video=video,
        connect=connect,
        record=record,
        link=link,
        faults=tuple(faults or ()),
        vision=VisionSource.of(vision),
        scene=tuple(scene or ()),
        cockpit=cockpit,
    )
    raise typer.Exit(simulate(options).exit_code)


def inspect(
    flight: Annotated[
        Path, typer.Argument(help="A flight's folder, as every flight and `follower import` leave.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="REPORT.HTML",
            help="Where the report goes; inspection.html in the flight's folder by default.",
        ),
    ] = None,
    foxglove: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.MCAP",
            help="Also write the flight for Foxglove: its messages, pictures, boxes, a scene. "
            "The layout is configs/viewers/foxglove.json.",
        ),
    ] = None,
    rerun: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.RRD", help="Also write the flight for rerun.io, with its layout."
        ),
    ] = None,
) -> None:
    """Report on a recorded flight, real or simulated: one HTML file that needs nothing else.

    States and their reasons, errors, setpoints asked and allowed, delays and ages, losses with
    pictures from the video, the map, and what the recording lacks. A recording that a power cut
    ended is reported on up to where it ends.
    """
    from follower.apps.inspect import inspect_flight

    inspect_flight(flight, out, foxglove=foxglove, rerun=rerun)


def scenarios(
    keys: Annotated[
        bool,
        typer.Option(
            "--keys", help="Print all keys of a scenario file instead, with what each one means."
        ),
    ] = False,
) -> None:
    """List the scenarios that come along."""
    from follower.settings.field_docs import explained_keys
    from follower_sim.scenario.scenario import Scenario
    from follower_sim.scenario.scenario_file import load_scenario

    if keys:
        typer.echo(explained_keys(Scenario), nl=False)
        return
    for name, path in scenario_files().items():
        typer.echo(f"{name:18} {load_scenario(path).title}")


def trackers() -> None:
    """List the motion trackers; `follower models list` says whose networks have to be fetched."""
    from follower_vision.trackers.registry import tracker_names

    for name in tracker_names():
        typer.echo(name)


def settings(config: Config = None, overrides: Overrides = None) -> None:
    """Print all settings as they resolve, each with what it means, as YAML to copy and edit."""
    from follower.apps.command_settings import lens_is_given
    from follower.settings.field_docs import explained_yaml
    from follower.settings.settings import load_settings

    resolved = load_settings(config, overrides=overrides or ())
    text = explained_yaml(resolved, resolved.to_yaml())
    if not lens_is_given(config, overrides):  # in a file, the default would pass for the user's
        text = text.replace("\n  fov_deg:", "\n  # fov_deg:")
    typer.echo(text, nl=False)


_COMMANDS: dict[str, tuple[tuple[str, str | None, Callable[..., None]], ...]] = {
    "Simulate": (
        ("demo", _DEMO_EPILOG, demo),
        ("sim", _SIM_EPILOG, sim),
        ("scenarios", None, scenarios),
        ("campaign", campaign.EPILOG, campaign.campaign_command),
        ("faults", fault_tests.EPILOG, fault_tests.faults_command),
        ("sitl", sitl.EPILOG, sitl.sitl_command),
    ),
    "Look at a flight": (
        ("inspect", _INSPECT_EPILOG, inspect),
        ("replay", replay.EPILOG, replay.replay_command),
    ),
    "Track recordings": (
        ("track", track.EPILOG, track.track_command),
        ("import", import_flight.EPILOG, import_flight.import_command),
        ("trackers", None, trackers),
        ("evaluate", evaluate.EPILOG, evaluate.evaluate_command),
        ("trax", evaluate.TRAX_EPILOG, evaluate.trax_command),
    ),
    "Fly": (
        ("settings", _SETTINGS_EPILOG, settings),
        ("doctor", doctor.EPILOG, doctor.doctor_command),
        ("bench", bench.EPILOG, bench.bench_command),
        ("preflight", preflight.EPILOG, preflight.preflight_command),
        ("fly", fly.EPILOG, fly.fly_command),
    ),
    "Tune": (
        ("excite", excite.EPILOG, excite.excite_command),
        ("identify", identify.EPILOG, identify.identify_command),
        ("tune", tune.EPILOG, tune.tune_command),
    ),
    "Train": (("export", EXPORT_EPILOG, export_command),),
    "ROS 2": (
        ("ros-demo", ros.DEMO_EPILOG, ros.ros_demo_command),
        ("ros-bag", ros.BAG_EPILOG, ros.ros_bag_command),
    ),
}
"""By what they are for, in the order in which the help lists them."""

for panel, commands in _COMMANDS.items():
    for name, epilog, command in commands:
        app.command(name, epilog=epilog, rich_help_panel=panel)(command)
# What it does not know, from --ros-args on, is ROS's.
_ROS_ARGS = {"allow_extra_args": True, "ignore_unknown_options": True}
app.command("ros", epilog=ros.EPILOG, context_settings=_ROS_ARGS, rich_help_panel="ROS 2")(
    ros.ros_command
)
app.add_typer(calibrate_app, name="calibrate", rich_help_panel="Fly")
app.add_typer(models_app, name="models", rich_help_panel="Track recordings")
app.add_typer(
    service_app, name="service", help="Start the follower with the computer.", rich_help_panel="Fly"
)
app.add_typer(train_app, name="train", rich_help_panel="Train")


def main() -> NoReturn:
    """Run the command line; what the user can mend ends in one line and exit code 2."""
    try:
        app()
    except (ValueError, OSError) as error:
        if not isinstance(error, _user_errors()):
            raise
        typer.echo(f"follower: {_said(error)}", err=True)
        sys.exit(UNUSABLE)
    sys.exit(SUCCESS)


def _said(error: Exception) -> str:
    """Return an error in one line; a file's with its name, and what is free if there is no room."""
    from follower_vision.disk import failure_said, is_no_room

    if isinstance(error, OSError) and error.filename and error.strerror:
        if is_no_room(error):
            return failure_said(error, Path(error.filename))
        return f"{error.filename}: {error.strerror}"
    return " ".join(str(error).split())


def _user_errors() -> tuple[type[Exception], ...]:
    """Return what a user can mend; any other error is ours and shows its traceback."""
    from follower.links.connections import ConnectionFailedError
    from follower_vision.onnx_network import ModelError
    from follower_vision.plugins import PluginError
    from follower_vision.sources.frame_source import SourceError

    return SettingsError, ConnectionFailedError, SourceError, ModelError, PluginError, OSError
