"""The command `follower import`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from follower.command_options import Config, Out, Overrides

EPILOG = """
**Examples**

`follower import clip.mp4 --target 320,180,40,30 --fov 78` – no telemetry: the image alone

`follower import clip.mp4 --telemetry flight.tlog --select person` – the offset is found

`follower import clip.mp4 --telemetry 00000042.BIN --offset 12.4 --target 320,180,40,30 --at 3.5`

Kinds of logs: tlog (MAVLink), .bin (ArduPilot), .ulg (PX4), .csv; docs/offline.md has the columns.
"""


def import_command(
    source: Annotated[
        str, typer.Argument(help="A video file, or a folder of images.", metavar="VIDEO")
    ],
    telemetry: Annotated[
        Path | None,
        typer.Option(metavar="LOG", help="The flight's telemetry: .tlog, .bin, .ulg or .csv."),
    ] = None,
    offset: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="The log's time, from its first attitude on, at the video's first frame. "
            "Found by comparing the image's turns with the gyro's if it is not given.",
        ),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,W,H",
            help="The target's box in pixels, in the frame at --at.",
            rich_help_panel="Which target",
        ),
    ] = None,
    select: Annotated[
        str | None,
        typer.Option(
            metavar="CLASS[:N]|N",
            help="By detector, as in `follower track`.",
            rich_help_panel="Which target",
        ),
    ] = None,
    colour: Annotated[
        str | None,
        typer.Option(
            metavar="#RRGGBB",
            help="The largest thing of this colour.",
            rich_help_panel="Which target",
        ),
    ] = None,
    at: Annotated[
        float,
        typer.Option(
            metavar="SECONDS",
            help="When the target is chosen, from the video's beginning on.",
            rich_help_panel="Which target",
        ),
    ] = 0.0,
    fov: Annotated[
        float | None,
        typer.Option(
            metavar="DEGREES",
            help="The camera's horizontal field of view; for calibrated intrinsics and the mount "
            "see `camera` in the settings.",
        ),
    ] = None,
    tracker: Annotated[
        str | None,
        typer.Option(
            help="The motion tracker; see `follower trackers`.", rich_help_panel="How to track"
        ),
    ] = None,
    detector: Annotated[
        str | None,
        typer.Option(
            help="The detector that validates it, e.g. yolox-nano, or an .onnx file.",
            rich_help_panel="How to track",
        ),
    ] = None,
    rate_hz: Annotated[float, typer.Option(help="Frames a second of a folder of images.")] = 30.0,
    config: Config = None,
    overrides: Overrides = None,
    out: Out = Path("runs"),
) -> None:
    """Make a flight of a video, and perhaps a telemetry log, that was recorded elsewhere.

    The code that flies follows the target and answers with setpoints. What is left is a flight's
    folder for `follower replay` and `follower inspect`, with the boxes, the setpoints and a report.
    """
    from follower.importing.options import ImportOptions
    from follower.importing.session import import_video
    from follower.track_command import parse_box

    options = ImportOptions(
        source,
        telemetry=telemetry,
        target=None if target is None else parse_box(target),
        select=select,
        colour=colour,
        at_s=at,
        offset_s=offset,
        fov_deg=fov,
        tracker=tracker,
        detector=detector,
        config=config,
        overrides=tuple(overrides or ()),
        out=out,
        rate_hz=rate_hz,
    )
    raise typer.Exit(import_video(options))
