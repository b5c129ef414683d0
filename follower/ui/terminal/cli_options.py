"""Command line options that `follower fly` and `follower preflight` share."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import typer

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
    str,
    typer.Option(
        metavar="SOURCE",
        help="A camera (0 or /dev/video0), a stream (rtsp://…, udp://0.0.0.0:5600), gst: and a "
        "GStreamer pipeline, or a recording, which is played at its own pace.",
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
        metavar="pymavlink|mavsdk",
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
