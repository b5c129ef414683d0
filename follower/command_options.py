"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

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
