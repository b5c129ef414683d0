"""The command `follower fly`."""

from pathlib import Path

import typer

from follower.ui.terminal.cli_options import (
    Camera,
    Cockpit,
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
    Tracker,
    typed_command,
)

EPILOG = """
**Examples**

`follower fly --connect /dev/ttyAMA0:921600 --camera 0 -c my.yaml --select person`

`follower fly --connect udpin:0.0.0.0:14540 --camera rtsp://10.0.0.5/live -c my.yaml --select car`

`follower fly --connect /dev/ttyAMA0:921600 --camera 0 -c my.yaml --cockpit` – choose on a web page

`follower fly --connect tcp:127.0.0.1:5760 --camera clip.mp4 -c my.yaml --colour '#d02020'` – SITL

**The flight**

1. The preflight checks: when one that is needed fails, it says which and what to do, and ends.

2. The pilot takes off and hovers where the camera sees the target. The terminal says what it
waits for. Nothing moves: this program never arms, takes off or changes the mode.

3. The pilot switches to OFFBOARD (PX4) or GUIDED (ArduPilot): it follows.

4. The pilot takes any other mode, or Ctrl-C: it stops and releases the vehicle. The flight's
folder holds the recording and a report.

Copy configs/fly/px4.yaml or configs/fly/ardupilot.yaml for `-c`. Read docs/how-to/fly.md first; do
the sign test (`follower preflight --sign-test`) before the first flight.
"""


def fly_command(
    connect: Connect,
    camera: Camera = None,
    select: Select = None,
    colour: Colour = None,
    target: Target = None,
    tracker: Tracker = None,
    detector: Detector = None,
    link: LinkKind = None,
    skip_preflight: Skip = None,
    config: Config = None,
    overrides: Overrides = None,
    out: Out = Path("runs"),
    cockpit: Cockpit = False,
) -> None:
    """Follow a target with a real vehicle: check, wait for the pilot, follow, release.

    Exit code 0: it ended as asked; 1: a preflight check refused it; 2: an option cannot be used; 3:
    the pilot or the operator took the vehicle back; 4: something failed; 130: Ctrl-C before it.
    """
    from follower.apps.command_settings import command_settings, lens_is_given, with_needed_detector
    from follower.apps.fly.opened import FlightPlan
    from follower.apps.fly.session import fly
    from follower.apps.preflight.checklist import check_names
    from follower.apps.preflight.session import CheckScope
    from follower.apps.target_choice import TargetChoice
    from follower.apps.video_input import VideoInput

    choice = TargetChoice.of([target] if target else (), [select] if select else (), colour)
    settings = command_settings(config, overrides, tracker=tracker, detector=detector, link=link)
    checks = CheckScope(check_names(skip_preflight or ()), out, lens_is_given(config, overrides))
    plan = FlightPlan(
        with_needed_detector(settings, bool(select)),
        choice,
        "the cockpit" if cockpit else "the ground station",
        VideoInput.camera(camera, settings.camera),
        connect,
        checks,
        config,
        typed_command(),
    )
    raise typer.Exit(fly(plan, cockpit))
