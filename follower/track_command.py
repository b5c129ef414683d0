"""The command `follower track`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from follower.command_options import Colour, Config, Out, Overrides
from follower_control.strict_yaml import SettingsError
from follower_vision.box import Box

_LEAST_SIDE_PX = 3
_WHICH, _HOW, _FILES = "Which target", "How to track", "Files"

EPILOG = """
**Examples**

`follower track clip.mp4 --target 320,180,40,30` – a box in the first frame; no network needed

`follower track clip.mp4 --select list` – number what the detector sees, print it and draw it

`follower track clip.mp4 --select person` – the person nearest to the centre

`follower track clip.mp4 --select person:1 --select person:3 --tracker nanotrack-v3` – two at once

`follower track rtsp://10.0.0.5/live --select car --save out.mp4` – a live stream, until Ctrl-C

`follower track clip.mp4 --select car --paper` – the algorithm of Panda and Barczyk as published

`follower track clip.mp4 --select car --without camera_motion,size_clamp` – what is a part worth?

Networks come by `follower models pull`: the usual tracker and detector.
"""


Source: TypeAlias = Annotated[
    str,
    typer.Argument(
        help="A video file, a folder of images, a camera (/dev/video0 or 0), a stream "
        "(rtsp://…, udp://0.0.0.0:5600), or gst: and a GStreamer pipeline.",
    ),
]
Targets: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        metavar="X,Y,W,H",
        help="A target's box in the first frame, in pixels; up to four times.",
        rich_help_panel=_WHICH,
    ),
]
Selections: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        metavar="CLASS[:N]|N|list",
        help="By detector: the CLASS nearest to the centre, as soon as one is seen; the N-th "
        "of it, or of all, counted from the centre; **list** shows them. Up to four times.",
        rich_help_panel=_WHICH,
    ),
]
Tracker: TypeAlias = Annotated[
    str | None,
    typer.Option(help="The motion tracker; see `follower trackers`.", rich_help_panel=_HOW),
]
Detector: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="The detector that validates it (Fusion), e.g. yolox-nano, or an .onnx file. "
        "--select, --appearance, --paper and --without take the usual one if none is named.",
        rich_help_panel=_HOW,
    ),
]
Appearance: TypeAlias = Annotated[
    str | None,
    typer.Option(
        help="An appearance network that helps to tell persons apart, e.g. osnet-x0.25, or an "
        ".onnx file.",
        rich_help_panel=_HOW,
    ),
]
Paper: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--paper",
        help="Fusion as in the paper, without the improvements.",
        rich_help_panel=_HOW,
    ),
]
Without: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME,…",
        help="Fusion without these improvements; a wrong name lists them.",
        rich_help_panel=_HOW,
    ),
]
Realtime: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--realtime",
        help="Play a recording at its own pace and look at the newest frame alone, as with a "
        "camera; otherwise every frame, as fast as possible.",
    ),
]
Rate: TypeAlias = Annotated[float, typer.Option(help="Frames a second of a folder of images.")]
Save: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        metavar="OUT.MP4", help="Where the video with overlay goes.", rich_help_panel=_FILES
    ),
]
Boxes: TypeAlias = Annotated[
    Path | None,
    typer.Option(
        metavar="OUT.CSV",
        help="Where the boxes go: a line a frame (frame, time, x, y, w, h, state, confidence, "
        "produced_by); with several targets a line for each, and its number in a last column, "
        "**target**.",
        rich_help_panel=_FILES,
    ),
]
Video: TypeAlias = Annotated[bool, typer.Option(help="Write the video.", rich_help_panel=_FILES)]
Record: TypeAlias = Annotated[
    bool,
    typer.Option(
        "--record",
        help="Record the run of the first target for `follower replay` and `follower inspect`.",
        rich_help_panel=_FILES,
    ),
]


def track_command(
    source: Source,
    target: Targets = None,
    select: Selections = None,
    colour: Colour = None,
    tracker: Tracker = None,
    detector: Detector = None,
    appearance: Appearance = None,
    paper: Paper = False,
    without: Without = None,
    realtime: Realtime = False,
    rate_hz: Rate = 30.0,
    save: Save = None,
    boxes: Boxes = None,
    video: Video = True,
    record: Record = False,
    config: Config = None,
    overrides: Overrides = None,
    out: Out = Path("runs"),
) -> None:
    """Track up to four targets in a recording or a live stream, with the code that flies.

    Writes the video with overlay, the boxes, a plot of the track over time and, of a recording, the
    setpoints that would have been sent. Ctrl-C ends it early with all files complete.
    """
    from follower.track import track
    from follower.track_options import TrackOptions

    options = TrackOptions(
        source=source,
        targets=tuple(parse_box(text) for text in target or ()),
        select=tuple(select or ()),
        colour=colour,
        tracker=tracker,
        detector=detector,
        appearance=appearance,
        paper=paper,
        without=_names(without or []),
        realtime=realtime,
        rate_hz=rate_hz,
        save=save,
        boxes=boxes,
        video=video,
        record=record,
        config=config,
        overrides=tuple(overrides or ()),
        out=out,
    )
    raise typer.Exit(track(options))


def _names(texts: list[str]) -> tuple[str, ...]:
    return tuple(name.strip() for text in texts for name in text.split(","))


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
