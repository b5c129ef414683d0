"""The command `follower fly`."""

from __future__ import annotations

from pathlib import Path

import typer

from follower.command_options import Cockpit, Colour, Config, Out, Overrides
from follower.fly_options import (
    Camera,
    Connect,
    Detector,
    LinkKind,
    Select,
    Skip,
    Target,
    Tracker,
)
from follower.track_command import parse_box

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

4. The pilot takes any other mode, or Ctrl-C: it stops and lets go. The flight's folder holds the
recording and a report.

Copy configs/fly/px4.yaml or configs/fly/ardupilot.yaml for `-c`. Read docs/fly.md first; do the
sign test (`follower preflight --sign-test`) before the first flight.
"""


def fly_command(
    connect: Connect,
    camera: Camera,
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
    """Follow a target with a real vehicle: check, wait for the pilot, follow, let go.

    Exit code 0 after a flight, 1 if a preflight check refused it, 2 if an option cannot be used.
    """
    from follower.fly.fly import fly
    from follower.fly.options import FlyOptions

    options = FlyOptions(
        connect,
        camera,
        target=None if target is None else parse_box(target),
        select=select,
        colour=colour,
        link=link,
        tracker=tracker,
        detector=detector,
        skip=tuple(skip_preflight or ()),
        config=config,
        overrides=tuple(overrides or ()),
        out=out,
        cockpit=cockpit,
    )
    raise typer.Exit(fly(options))
