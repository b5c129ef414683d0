"""The command `follower preflight`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from follower.ui.terminal.cli_options import (
    Camera,
    Colour,
    Config,
    Connect,
    Detector,
    LinkKind,
    Out,
    Overrides,
    Select,
    Skip,
    Target,
)

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
    camera: Camera = None,
    config: Config = None,
    overrides: Overrides = None,
    link: LinkKind = None,
    skip_preflight: Skip = None,
    as_json: Annotated[bool, typer.Option("--json", help="Everything, for programs.")] = False,
    seconds: Annotated[
        float,
        typer.Option(
            min=1, max=600, help="How long to look at most before a check counts as failed."
        ),
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
    from follower.apps.command_settings import command_settings, lens_is_given, with_needed_detector
    from follower.apps.preflight.checklist import check_names
    from follower.apps.preflight.session import CheckScope, preflight
    from follower.apps.target_choice import TargetChoice
    from follower.apps.video_input import VideoInput

    settings = command_settings(config, overrides, detector=detector, link=link)
    checks = CheckScope(
        check_names(skip_preflight or ()), out, lens_is_given(config, overrides), seconds
    )
    source = VideoInput.camera(camera, settings.camera)
    if not sign_test:
        raise typer.Exit(preflight(settings, source, connect, checks, as_json))

    from follower.apps.preflight.sign_test import sign_test as run_sign_test

    choice = TargetChoice.of([target] if target else (), [select] if select else (), colour)
    settings = with_needed_detector(settings, bool(select))
    raise typer.Exit(run_sign_test(settings, choice, source, connect, checks.lens_given))
