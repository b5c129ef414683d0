"""Options that every training takes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Config = Annotated[
    Path | None,
    typer.Option(
        "--config",
        "-c",
        help="The recipe (YAML); otherwise the one named like the command in configs/train/.",
    ),
]
Out = Annotated[Path, typer.Option(help="Folder in which each training gets its own.")]
Resume = Annotated[
    Path | None, typer.Option(help="Go on with a training's folder, with its own recipe.")
]
Device = Annotated[
    str, typer.Option(help="**auto** takes a GPU if there is one.", metavar="auto|cpu|cuda")
]

RUNS = Path("runs/train")
"""Where trainings go unless `Out` says otherwise."""
