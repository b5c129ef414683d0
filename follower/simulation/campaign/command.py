"""The command `follower campaign`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

EPILOG = """
**Examples**

`follower campaign quick` – a few flights without pixels, to see what comes of it

`follower campaign standard --vision truth+noise --workers 4` – a thousand, in four processes

`follower campaign mine.yaml --dask tcp://10.0.0.1:8786` – on the workers of a Dask scheduler

`follower campaign quick --video 3` – fly the three worst again, with video and report

`follower campaign gains.yaml --optimise` – search gains with a smaller cost

Ctrl-C or a crash loses no finished run: the same command goes on where it stopped. Exit code 0: all
goals were met; 1: not all; 2: the campaign cannot be used; 130: ended by Ctrl-C.
"""


def campaign_command(
    campaign: Annotated[
        str,
        typer.Argument(help="A campaign file (YAML), or a name in configs/campaigns: standard …"),
    ],
    workers: Annotated[
        int, typer.Option(min=1, help="How many processes fly at a time, here.")
    ] = 1,
    dask: Annotated[
        str | None,
        typer.Option(
            "--dask",
            "--scheduler",
            metavar="ADDRESS",
            help="Fly on the workers of this Dask scheduler instead.",
        ),
    ] = None,
    vision: Annotated[
        str | None,
        typer.Option(
            metavar="pixels|truth+noise",
            help="What sees; by default what the file says. Results say which it was.",
        ),
    ] = None,
    runs: Annotated[
        int | None, typer.Option(min=1, help="How many runs to draw, instead of the file's.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder of this campaign; runs/campaign-NAME by default.")
    ] = None,
    video: Annotated[
        int,
        typer.Option(
            min=0, metavar="WORST", help="Fly the worst runs that failed again, so many, filmed."
        ),
    ] = 0,
    optimise: Annotated[
        bool, typer.Option("--optimise", help="Search settings by the campaign's cost.")
    ] = False,
) -> None:
    """Fly many simulated flights, count what came of them, and report on it."""
    from follower.simulation.campaign.config import load_campaign
    from follower.simulation.campaign.run import run_campaign
    from follower.ui.terminal.console import needed
    from follower.workers import engine_for

    needed("pyarrow")
    config = load_campaign(campaign, vision=vision, runs=runs)
    folder = out or Path("runs") / f"campaign-{config.name}"
    raise typer.Exit(run_campaign(config, folder, engine_for(workers, dask), video, optimise))
