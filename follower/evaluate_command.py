"""The command `follower evaluate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def evaluate_command(
    folders: Annotated[
        list[Path],
        typer.Argument(help="Sequences or folders of them: OTB, UAV123, VOT, GOT-10k, plain."),
    ],
    trackers: Annotated[
        str,
        typer.Option(
            metavar="A,B,C",
            help="Names from `follower trackers`; also longterm:NAME, fusion:NAME, "
            "fusion-paper:NAME.",
        ),
    ] = "correlation",
    detector: Annotated[str, typer.Option(help="Fusion's detector.")] = "yolox-nano",
    boxes: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=FOLDER",
            help="Another program's boxes: SEQUENCE.txt each, x,y,w,h a line.",
        ),
    ] = None,
    tre: Annotated[int, typer.Option(min=0, help="Also start from so many frames.")] = 0,
    sre: Annotated[bool, typer.Option("--sre", help="Also start from twelve moved boxes.")] = False,
    out: Annotated[Path, typer.Option(help="Folder in which each run gets its own.")] = Path(
        "runs"
    ),
    resume: Annotated[
        Path | None, typer.Option(help="Go on with a run's folder; what is done is kept.")
    ] = None,
) -> None:
    """Measure trackers on data sets: success, precision, speed; a table and an HTML report."""
    from follower.evaluate.evaluation import EvaluateOptions, evaluate

    names = tuple(name.strip() for name in trackers.split(",") if name.strip())
    options = EvaluateOptions(
        tuple(folders), names, detector, tuple(boxes or ()), tre, sre, out, resume
    )
    raise typer.Exit(evaluate(options))
