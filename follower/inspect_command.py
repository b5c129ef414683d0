"""The command `follower inspect`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

EPILOG = """
**Examples**

`follower inspect runs/fly` – writes runs/fly/inspection.html

`follower inspect runs/demo --out demo.html` – somewhere else
"""


def inspect_command(
    flight: Annotated[
        Path, typer.Argument(help="A flight's folder, as every flight and `follower import` leave.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="REPORT.HTML",
            help="Where the report goes; inspection.html in the flight's folder by default.",
        ),
    ] = None,
) -> None:
    """Report on a recorded flight, real or simulated: one HTML file that needs nothing else.

    States and their reasons, errors, setpoints asked and allowed, delays and ages, losses with
    pictures from the video, the map, and what the recording lacks. A recording that a power cut
    ended is reported on up to where it ends.
    """
    from follower.inspection import inspect_flight

    inspect_flight(flight, out)
