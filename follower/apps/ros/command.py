"""The commands `follower ros`, `follower ros-demo` and `follower ros-bag`."""

from itertools import takewhile
from pathlib import Path
from types import ModuleType
from typing import Annotated

import typer

from follower.ui.terminal.cli_options import Config, Out, Overrides, Skip
from follower_control.common.strict_config import SettingsError

EPILOG = """
**Examples**

`follower ros --activate --ros-args -r image:=/camera/image_raw` – tracks; others fly

`follower ros --mode mavros -c my.yaml --ros-args -r image:=/camera/image_raw` – through MAVROS

`follower ros --mode direct --connect /dev/ttyAMA0:921600 -c my.yaml` – our own MAVLink link

Then `ros2 lifecycle set /follower configure` and `activate`. Every setting is a parameter:
`ros2 param set /follower servo.mode orbit`. More: examples/follower-ros/README.md.
"""
DEMO_EPILOG = """
**Examples**

`follower ros-demo` – the simulator and the node, a process each; runs/ros-demo holds the picture

`follower ros-demo --mode mavros` – through a simulated MAVROS; needs mavros_msgs
"""
BAG_EPILOG = """
**Examples**

`follower ros-bag runs/fly` – writes runs/fly/bag, for Foxglove and `ros2 bag play`

`follower ros-bag flight.bag --out unpacked` – a video and a table, for `follower import`
"""
_EXTRA = (
    "ROS 2's Python packages are not here ({}): source a ROS 2 set-up, or pip install -e '.[ros]'"
)

_STEERED = ("mavros", "direct")

Mode = Annotated[
    str,
    typer.Option(
        "--mode",
        metavar="perception|mavros|direct",
        help="Who flies: others, from **perception**; MAVROS, to which setpoints go; or the "
        "autopilot **direct**, by MAVLink.",
    ),
]


def ros_command(
    context: typer.Context,
    mode: Mode = "perception",
    target: Annotated[
        str, typer.Option(help="car, '#d02020' or x,y,w,h; nothing leaves it to ROS.")
    ] = "",
    connect: Annotated[
        str, typer.Option(help="Where the autopilot speaks MAVLink, in mode direct.")
    ] = "udpin:0.0.0.0:14540",
    image_transport: Annotated[
        str, typer.Option(metavar="raw|compressed", help="Which image topic is taken.")
    ] = "raw",
    detections: Annotated[
        str, typer.Option(help="Topic of another node's vision_msgs/Detection2DArray.")
    ] = "",
    activate: Annotated[
        bool, typer.Option("--activate", help="Configure and activate at once.")
    ] = False,
    skip_preflight: Skip = None,
    config: Config = None,
    overrides: Overrides = None,
    out: Out = Path("runs"),
) -> None:
    """Be a lifecycle node of ROS 2: images and a vehicle's state in, tracks and setpoints out.

    Configure listens, activate checks and begins, deactivate brakes, holds and releases. Consent
    stays the pilot's mode. Exit code 0: ended as asked; 1: it could not be activated; 2: an option
    cannot be used, or ROS is missing.
    """
    from follower.apps.command_settings import command_settings

    ours = takewhile(lambda one: one != "--ros-args", context.args)
    unknown = next(ours, None)
    if unknown is not None:
        raise typer.BadParameter(
            f"{unknown}: there is no such option; ROS's stand after --ros-args"
        )
    settings = command_settings(config, overrides)
    node = _needs_ros()
    options = node.NodeOptions(
        mode=mode,
        target=target,
        connect=connect,
        image_transport=image_transport,
        out=str(out),
        skip_preflight=" ".join(skip_preflight or ()),
        config="" if config is None else str(config),
        detections=detections,
    )
    raise typer.Exit(node.run_node(options, settings, context.args, activate=activate))


def ros_demo_command(
    mode: Annotated[
        str,
        typer.Option(metavar="|".join(_STEERED), help="Through which the node steers."),
    ] = "direct",
    scenario: Annotated[
        str, typer.Option(help="A scenario file (YAML) or a name from `follower scenarios`.")
    ] = "winding",
    seconds: Annotated[float, typer.Option(help="How long it follows.")] = 20.0,
    out: Out = Path("runs"),
) -> None:
    """Fly a scenario over ROS: the simulator is one process, the node another.

    The recording, its report and a picture of the overlay topic are left in the flight's folder.
    Exit code 0: it followed; 1: it did not; 2: an option cannot be used, or ROS is missing.
    """
    if mode not in _STEERED:
        raise SettingsError(f"--mode {mode}: the demo is flown by {' or '.join(_STEERED)}")
    _needs_ros()
    from follower.apps.ros.demo import fly_demo

    raise typer.Exit(fly_demo(mode, scenario, seconds, out))


def ros_bag_command(
    source: Annotated[Path, typer.Argument(help="A flight's folder, or a bag.")],
    out: Annotated[
        Path | None,
        typer.Option(help="Where to; `bag` or `unpacked` in it, or beside a file, by default."),
    ] = None,
) -> None:
    """Make a rosbag2 (MCAP) of a recorded flight, or of a bag what `follower import` takes."""
    try:
        from follower.apps.ros import bag
    except ImportError as error:
        raise SettingsError(_EXTRA.format(error)) from error
    from follower.apps.video_input import is_bag

    if is_bag(source):
        beside = source if source.is_dir() else source.parent
        typer.echo(bag.unpack(source, out or beside / "unpacked"))
    else:
        typer.echo(bag.pack(source, out or source / "bag"))


def _needs_ros() -> ModuleType:
    """Import the node.

    Raises:
        SettingsError: ROS is missing.
    """
    try:
        from follower.apps.ros import node
    except ImportError as error:
        raise SettingsError(_EXTRA.format(error)) from error
    return node
