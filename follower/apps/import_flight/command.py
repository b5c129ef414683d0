"""The command `follower import`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from follower.ui.terminal.cli_options import (
    Colour,
    Config,
    Detector,
    Out,
    Overrides,
    Select,
    Target,
    Tracker,
)

EPILOG = """
**Examples**

`follower import clip.mp4 --target 320,180,40,30 --fov 78` – no telemetry: the image alone

`follower import clip.mp4 --telemetry flight.tlog --select person` – the offset is found

`follower import clip.mp4 --telemetry 00000042.BIN --offset 12.4 --target 320,180,40,30 --at 3.5`

Kinds of logs: tlog (MAVLink), .bin (ArduPilot), .ulg (PX4), .csv, whose columns are in
docs/how-to/offline-flight.md.
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
    target: Target = None,
    select: Select = None,
    colour: Colour = None,
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
    tracker: Tracker = None,
    detector: Detector = None,
    rate_hz: Annotated[float, typer.Option(help="Frames a second of a folder of images.")] = 30.0,
    config: Config = None,
    overrides: Overrides = None,
    out: Out = Path("runs"),
) -> None:
    """Make a flight of a video, and perhaps a telemetry log, that was recorded elsewhere.

    The code that flies follows the target and answers with setpoints. What is left is a flight's
    folder for `follower replay` and `follower inspect`, with the boxes, the setpoints and a report.
    """
    from follower.apps.command_settings import command_settings, with_needed_detector
    from follower.apps.import_flight.session import import_video
    from follower.apps.target_choice import TargetChoice
    from follower.apps.video_input import VideoInput

    choice = TargetChoice.of([target] if target else (), [select] if select else (), colour)
    implied = () if fov is None else (f"camera.fov_deg={fov}",)
    settings = command_settings(
        config, overrides, tracker=tracker, detector=detector, implied=implied
    )
    settings = with_needed_detector(settings, select is not None)
    video = VideoInput(source, rate_hz=rate_hz)
    raise typer.Exit(import_video(video, settings, choice, at, telemetry, offset, out))
