"""The command `follower import`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from follower.ui.terminal.cli_options import (
    Colour,
    Config,
    Detector,
    Overrides,
    Select,
    Tracker,
)

EPILOG = """
**Examples**

`follower import DJI_0042.MP4` – with DJI_0042.SRT beside it; no target is needed then

`follower import fmv.ts --select car` – MISB ST 0601, as GPMF in a GoPro's MP4, is in the file

`follower import clip.mp4 flight.tlog --select person` – the time offset is found

`follower import clip.mp4 --target 320,180,40,30 --fov 78` – no telemetry: the image alone

`follower import 00000042.BIN` – telemetry alone; `follower import bag/` – a rosbag2

`follower import clip.mp4 --telemetry 00000042.BIN --offset 12.4 --target 320,180,40,30 --at 3.5`

Kinds of logs: tlog (MAVLink), .bin (ArduPilot), .ulg (PX4), .srt (DJI, Autel), .csv, whose
columns are in docs/how-to/offline-flight.md.
"""


def import_command(
    files: Annotated[
        list[str],
        typer.Argument(
            help="A video file, a folder of images or a bag; its telemetry, if that is another "
            "file; or telemetry alone. What is in them tells which is which.",
            metavar="FILE",
        ),
    ],
    telemetry: Annotated[
        Path | None,
        typer.Option(
            metavar="LOG", help="The flight's telemetry: may stand among the FILEs as well."
        ),
    ] = None,
    offset: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            help="The log's time, from its first attitude on, at the video's first frame; of "
            "telemetry that came with the video, by how much it is late. "
            "Found by comparing the image's turns with the gyro's if it is not given.",
        ),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,W,H",
            help="A box in the first frame, or in that of --at, in pixels.",
            rich_help_panel="Which target",
        ),
    ] = None,
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
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder in which each run gets a folder of its own.")
    ] = Path("runs"),
) -> None:
    """Make a flight of what another drone, camera or program recorded: video, telemetry or both.

    The code that flies follows the target and answers with setpoints. What is left is a flight's
    folder for `follower replay` and `follower inspect`, with the boxes, the setpoints and a report.
    """
    from follower.apps.command_settings import (
        command_settings,
        lens_is_given,
        with_needed_detector,
    )
    from follower.apps.import_flight.inputs import sort_inputs
    from follower.apps.import_flight.session import import_video
    from follower.apps.target_choice import TargetChoice

    choice = TargetChoice.of([target] if target else (), [select] if select else (), colour)
    implied = () if fov is None else (f"camera.fov_deg={fov}",)
    settings = command_settings(
        config, overrides, tracker=tracker, detector=detector, implied=implied
    )
    settings = with_needed_detector(settings, select is not None)
    video, log = sort_inputs(files, telemetry, rate_hz)
    lens_given = fov is not None or lens_is_given(config, overrides)
    inputs = video, settings, choice, at, log, offset, out
    raise typer.Exit(import_video(*inputs, lens_given=lens_given))
