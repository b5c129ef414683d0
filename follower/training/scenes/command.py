"""The command `follower train sequences`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

EPILOG = """
**Example**

`follower train sequences generated/ --stock runs/train/follower-re3/stock --count 100`, then
`follower evaluate generated/ --trackers re3,correlation`
"""


def sequences_command(
    out: Annotated[Path, typer.Argument(help="Folder in which each sequence gets its own.")],
    stock: Annotated[
        Path | None,
        typer.Option(help="Pictures prepared by a training; procedural ones otherwise."),
    ] = None,
    worlds: Annotated[
        int, typer.Option(min=0, help="Simulated worlds whose views and bodies join the pictures.")
    ] = 0,
    count: Annotated[int, typer.Option(min=1, help="How many sequences.")] = 100,
    frames: Annotated[int, typer.Option(min=2, help="How long each is.")] = 60,
    seed: Annotated[
        int, typer.Option(min=0, help="Of the scenes; trainings use small numbers.")
    ] = 777,
) -> None:
    """Write generated sequences to measure trackers on: images and true boxes."""
    import numpy as np
    from rich.progress import track

    from follower.training.scenes.maker import SceneMaker
    from follower.training.scenes.pictures import procedural
    from follower.training.scenes.rendered import rendered
    from follower.training.scenes.settings import SceneSettings
    from follower.training.scenes.stock import load
    from follower.training.scenes.writer import write_sequence

    pictures = procedural(np.random.default_rng(seed)) if stock is None else load(stock, seed)
    pictures = pictures.joined(rendered(np.random.default_rng(seed), worlds))
    maker = SceneMaker(pictures, SceneSettings(), seed)
    for index in track(range(count), "sequences", transient=True):
        write_sequence(maker.scene(index, frames), out / f"generated_{index:03}")
    typer.echo(out)
