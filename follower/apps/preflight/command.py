"""The command `follower preflight`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from follower.command_options import Colour, Config, Out, Overrides
from follower.fly_options import Camera, Connect, Detector, LinkKind, Select, Skip, Target
from follower.track_command import parse_box

EPILOG = """
**Examples**

`follower preflight --connect udpin:0.0.0.0:14540 --camera 0 -c my.yaml` – the checklist

`follower preflight … --json` – the same for programs

`follower preflight … --sign-test --select person` – turn the vehicle by hand, see what it would do

Nothing is sent but heartbeats and questions: no setpoint, no command that moves anything.
Exit code 0: everything that is needed passed; 1: it did not; 2: an option cannot be used.
"""


def preflight_command(
    connect: Connect,
    camera: Camera,
    config: Config = None,
    overrides: Overrides = None,
    link: LinkKind = None,
    skip_preflight: Skip = None,
    as_json: Annotated[bool, typer.Option("--json", help="Everything, for programs.")] = False,
    seconds: Annotated[
        float, typer.Option(help="How long to look at most before a check counts as failed.")
    ] = 12.0,
    sign_test: Annotated[
        bool,
        typer.Option(
            "--sign-test",
            help="Disarmed, by hand: show live which way the vehicle would turn, climb and move, "
            "and find out whether the camera is mirrored, rotated or mounted otherwise than the "
            "settings say. Needs a target.",
        ),
    ] = False,
    select: Select = None,
    colour: Colour = None,
    target: Target = None,
    detector: Detector = None,
    out: Out = Path("runs"),
) -> None:
    """Check link, autopilot, its parameters, camera and computer before a flight.

    Each check says pass, warn, fail or unknown, why, and what to do.
    """
    from follower.fly.options import FlyOptions

    options = FlyOptions(
        connect,
        camera,
        target=None if target is None else parse_box(target),
        select=select,
        colour=colour,
        link=link,
        detector=detector,
        skip=tuple(skip_preflight or ()),
        config=config,
        overrides=tuple(overrides or ()),
        out=out,
        needs_target=sign_test,
        look_s=seconds,
    )
    if sign_test:
        from follower.fly.sign_testing import sign_test as run_sign_test

        raise typer.Exit(run_sign_test(options))
    from follower.fly.preflight import preflight

    raise typer.Exit(preflight(options, as_json))
