"""Options that several commands share."""

import shlex
import sys
from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from follower.settings.link import LINK_KINDS
from follower_control.common.strict_config import SettingsError
from follower_vision.geometry.box import Box
from follower_vision.sources.capture import without_password

Config: TypeAlias = Annotated[
    Path | None, typer.Option("--config", "-c", help="Settings (YAML); see `follower settings`.")
]
Overrides: TypeAlias = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="One setting, e.g. servo.distance_m=12."),
]
Out: TypeAlias = Annotated[
    Path, typer.Option(help="Folder in which each run gets a folder of its own.")
]
Video: TypeAlias = Annotated[bool, typer.Option(help="Write the video with overlay.")]
Colour: TypeAlias = Annotated[
    str | None,
    typer.Option(
        metavar="#RRGGBB",
        help="The largest thing of this colour.",
        rich_help_panel="Which target",
    ),
]
Cockpit: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--cockpit",
        help="Show it on a web page, at http://127.0.0.1:8080 unless the settings say otherwise.",
    ),
]


_LEAST_SIDE_PX = 3


def parse_box(text: str) -> Box:
    """Read a target's "x,y,w,h".

    Raises:
        SettingsError: it is none, or too small.
    """
    try:
        x, y, width, height = (float(part) for part in text.split(","))
        box = Box.from_xywh(x, y, width, height)
    except ValueError:
        raise SettingsError(
            f"--target {text}: write x,y,w,h in pixels with w and h above 0, for example "
            "320,180,40,30"
        ) from None
    if min(width, height) < _LEAST_SIDE_PX:
        raise SettingsError(
            f"--target {text}: a box of fewer than {_LEAST_SIDE_PX} pixels a side shows too little"
        )
    return box


_WHICH, _HOW = "Which target", "How"

Connect: TypeAlias = Annotated[
    str,
    typer.Option(
        metavar="udpin:HOST:PORT|tcp:HOST:PORT|DEVICE:BAUD",
        help="Where the autopilot speaks MAVLink, e.g. udpin:0.0.0.0:14540, tcp:127.0.0.1:5760, "
        "/dev/ttyAMA0:921600.",
    ),
]
Camera: TypeAlias = Annotated[
    str | None,
    typer.Option(
        metavar="SOURCE",
        help="A camera (0 or /dev/video0), a stream (rtsp://…, udp://0.0.0.0:5600, "
        "rtp://0.0.0.0:5600), rpicam:0, argus:0, siyi:, gst: and a GStreamer pipeline "
        "(docs/how-to/live-video.md), or a recording, which is played at its own pace. "
        "`camera.source` of the settings by default.",
    ),
]
Select: TypeAlias = Annotated[
    str | None,
    typer.Option(
        metavar="CLASS[:N]|N",
        help="By detector: the CLASS nearest to the image's centre, or the N-th from it.",
        rich_help_panel=_WHICH,
    ),
]
Target: TypeAlias = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,W,H",
        help="A box in the first frame after the preflight checks, in pixels.",
        rich_help_panel=_WHICH,
    ),
]
LinkKind: TypeAlias = Annotated[
    str | None,
    typer.Option(
        "--link",
        help="Which library speaks MAVLink: **pymavlink** (default) or **mavsdk**.",
        metavar="|".join(LINK_KINDS),
        rich_help_panel=_HOW,
    ),
]
Tracker: TypeAlias = Annotated[
    str | None,
    typer.Option(help="The motion tracker; see `follower trackers`.", rich_help_panel=_HOW),
]
Detector: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="The detector that validates it, e.g. yolox-nano, or an .onnx file; --select takes "
        "the usual one if none is named.",
        rich_help_panel=_HOW,
    ),
]
Skip: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--skip-preflight",
        metavar="NAME",
        help="Fly although this check fails; you take the responsibility. May be repeated.",
        rich_help_panel=_HOW,
    ),
]


def typed_command() -> str:
    """Return the command line that was typed, without passwords: for reports and recordings."""
    return shlex.join(["follower", *map(without_password, sys.argv[1:])])
