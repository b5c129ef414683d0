"""The command `follower track`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from follower.ui.terminal.cli_options import Colour, Config, Out, Overrides, Tracker

_WHICH, _HOW, _FILES = "Which target", "How", "Files"

EPILOG = """
**Examples**

`follower track clip.mp4 --target 320,180,40,30` – a box in the first frame; no network needed

`follower track clip.mp4 --select list` – number what the detector sees, print it and draw it

`follower track clip.mp4 --select person` – the person nearest to the centre

`follower track clip.mp4 --select person:1 --select person:3 --tracker nanotrack-v3` – two at once

`follower track rtsp://10.0.0.5/live --select car --save out.mp4` – a live stream, until Ctrl-C

`follower track clip.mp4 --select car --paper` – the algorithm of Panda and Barczyk as published

Networks come by `follower models pull`: the usual tracker and detector.
"""


def track_command(
    source: Annotated[
        str,
        typer.Argument(
            help="A video file, a folder of images, a camera (/dev/video0 or 0), a stream "
            "(rtsp://…, udp://0.0.0.0:5600, rtp://0.0.0.0:5600), rpicam:0, argus:0, siyi:, or gst: "
            "and a GStreamer pipeline.",
        ),
    ],
    target: Annotated[
        list[str] | None,
        typer.Option(
            metavar="X,Y,W,H",
            help="A target's box in the first frame, in pixels; up to four times.",
            rich_help_panel=_WHICH,
        ),
    ] = None,
    select: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CLASS[:N]|N|list",
            help="By detector: the CLASS nearest to the centre, as soon as one is seen; the N-th "
            "of it, or of all, counted from the centre; **list** shows them. Up to four times.",
            rich_help_panel=_WHICH,
        ),
    ] = None,
    colour: Colour = None,
    tracker: Tracker = None,
    detector: Annotated[
        str | None,
        typer.Option(
            help="The detector that validates it (Fusion), e.g. yolox-nano, or an .onnx file. "
            "--select and --paper take the usual one if none is named; where no tracker is named "
            "either, siamese-correlation with the embedded one follows a --target.",
            rich_help_panel=_HOW,
        ),
    ] = None,
    paper: Annotated[
        bool,
        typer.Option(
            "--paper",
            help="Fusion as published by Panda and Barczyk.",
            rich_help_panel=_HOW,
        ),
    ] = False,
    realtime: Annotated[
        bool,
        typer.Option(
            "--realtime",
            help="Play a recording at its own pace and look at the newest frame alone, as with a "
            "camera; otherwise every frame, as fast as possible.",
        ),
    ] = False,
    rate_hz: Annotated[float, typer.Option(help="Frames a second of a folder of images.")] = 30.0,
    save: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.MP4", help="Where the video with overlay goes.", rich_help_panel=_FILES
        ),
    ] = None,
    boxes: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.CSV",
            help="Where the boxes go: a line a frame (frame, time, x, y, w, h, state, confidence, "
            "produced_by); with several targets a line for each, and its number in a last column, "
            "**target**.",
            rich_help_panel=_FILES,
        ),
    ] = None,
    video: Annotated[bool, typer.Option(help="Write the video.", rich_help_panel=_FILES)] = True,
    record: Annotated[
        bool,
        typer.Option(
            "--record",
            help="Record the run of the first target for `follower replay` and `follower inspect`.",
            rich_help_panel=_FILES,
        ),
    ] = False,
    config: Config = None,
    overrides: Overrides = None,
    out: Out = Path("runs"),
) -> None:
    """Track up to four targets in a recording or a live stream, with the code that flies.

    Writes the video with overlay, the boxes, a plot of the track over time and, of a recording, the
    setpoints that would have been sent. Ctrl-C ends it early with all files complete.
    """
    from follower.apps.command_settings import (
        command_settings,
        implied_tracker,
        with_needed_detector,
    )
    from follower.apps.target_choice import TargetChoice
    from follower.apps.track.run import TrackFiles
    from follower.apps.track.session import track
    from follower.apps.video_input import VideoInput

    choice = TargetChoice.of(target or (), select or (), colour)
    settings = command_settings(
        config,
        overrides,
        tracker=tracker,
        detector=detector,
        implied=("fusion.algorithm=paper",)
        if paper
        else implied_tracker(config, overrides, tracker, detector, *(select or ())),
    )
    settings = with_needed_detector(settings, bool(select or paper))
    video_input = VideoInput(source, realtime, rate_hz, settings.camera.capture)
    files = TrackFiles(out=out, save=save, boxes=boxes, video=video, record=record)
    raise typer.Exit(track(settings, choice, video_input, files))
