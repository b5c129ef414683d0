"""The commands `follower evaluate` and `follower trax`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

EPILOG = """
**Examples**

`follower evaluate otb/ --trackers correlation,nanotrack-v3` – two trackers over a folder

`follower evaluate otb/car4 --trackers fusion:nanotrack-v3+yolox-nano --sre` – one sequence, moved
starts

`follower evaluate otb/ --boxes theirs=results/` – beside another program's boxes

`follower evaluate otb/ --trackers correlation,nanotrack-v3 --resume runs/evaluate` – the same
command goes on where it was stopped, or killed
"""
TRAX_EPILOG = """
**Example**, in `trackers.ini` of a workspace of vot-toolkit; then `vot evaluate Fusion` runs it

`[Fusion]`

`label = Fusion`

`protocol = trax`

`command = follower trax fusion:nanotrack-v3`
"""

Threads = Annotated[int, typer.Option(min=1, max=256, help="OpenCV's threads.")]


def evaluate_command(
    folders: Annotated[
        list[Path],
        typer.Argument(
            help="Data sets as they are unpacked, sequences, or folders of these: GOT-10k, OTB, "
            "UAV123, UAVDT, DTB70, VisDrone-SOT, LaSOT, TrackingNet, VOT, plain."
        ),
    ],
    trackers: Annotated[
        str,
        typer.Option(
            metavar="A,B,C",
            help="Names from `follower trackers`; fusion and fusion-paper (the paper's algorithm), "
            "alone or as KIND:NAME or KIND:NAME+DETECTOR, for fusion also +none. The others are "
            "compared with the first.",
        ),
    ] = "correlation",
    detector: Annotated[
        str, typer.Option(help="Fusion's detector where the name gives none.")
    ] = "yolox-nano",
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
        Path | None,
        typer.Option(help="Go on with a run's folder by the same command; what is done is kept."),
    ] = None,
    fps: Annotated[
        float,
        typer.Option(min=0.1, max=1000, help="Frames a second where the data set does not say."),
    ] = 30.0,
    threads: Threads = 1,
    workers: Annotated[
        int, typer.Option(min=0, help="Processes; 0: this one. Several slow one another down.")
    ] = 0,
    dask: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Run on this Dask scheduler's workers instead."),
    ] = None,
) -> None:
    """Measure trackers on data sets: success, precision, speed, with intervals; an HTML report."""
    import cv2

    from follower.apps.evaluate.run import EvaluationPlan, evaluate

    cv2.setNumThreads(threads)
    plan = EvaluationPlan(
        folders,
        [name.strip() for name in trackers.split(",") if name.strip()],
        detector=detector,
        boxes=boxes or (),
        tre=tre,
        sre=sre,
        out=out,
        resume=resume,
        fps=fps,
        workers=workers,
        dask=dask,
    )
    raise typer.Exit(evaluate(plan))


def trax_command(
    tracker: Annotated[str, typer.Argument(help="A name as in `follower evaluate --trackers`.")],
    detector: Annotated[
        str, typer.Option(help="Fusion's detector where the name gives none.")
    ] = "yolox-nano",
    fps: Annotated[
        float, typer.Option(min=0.1, max=1000, help="Frames a second of the images.")
    ] = 30.0,
    threads: Threads = 1,
) -> None:
    """Be a tracker for vot-toolkit and other TraX clients, by standard input and output."""
    import sys

    import cv2

    from follower.apps.evaluate.contender import Contender
    from follower.apps.evaluate.trax import serve

    cv2.setNumThreads(threads)
    serve(Contender(tracker, detector), fps, sys.stdin, sys.stdout)
