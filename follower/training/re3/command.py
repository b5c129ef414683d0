"""The commands `follower train re3` and `follower export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from follower.command_options import Overrides
from follower.print_line import print_line
from follower.training.options import RUNS, Config, Device, Out, Resume

if TYPE_CHECKING:
    from follower.training.re3.config import Re3Config

EPILOG = """
**Examples**

`follower train re3 --pictures pictures/` – the tracker that comes along; the head of
configs/train/pictures.yaml says how to get the pictures, and what licences they have

`follower train re3` – from procedural pictures alone: nothing to fetch, a weaker tracker

`follower train re3 --resume runs/train/follower-re3` – go on where it was stopped

Look at samples.png before you wait for the rest.
"""
EXPORT_EPILOG = """
**Example**

`follower export runs/train/follower-re3` – the network of its last checkpoint, as it stands
"""


def train_re3_command(
    config: Config = None,
    overrides: Overrides = None,
    pictures: Annotated[
        Path | None,
        typer.Option(help="Folder into which the packages of pictures.yaml were unpacked."),
    ] = None,
    out: Out = RUNS,
    resume: Resume = None,
    device: Device = "auto",
) -> None:
    """Train the motion tracker Re3 on generated sequences and write it as an ONNX file.

    Gives the network, its card, the log and a picture of what it learns from. About an hour on one
    core.
    """
    from follower.training.extra import check_extra

    check_extra()
    from rich.console import Console

    from follower.training.device import find_device
    from follower.training.re3.run import Re3Run

    settings = _config(resume / "config.yaml" if resume else config, overrides or [], pictures)
    folder = resume or out / settings.name
    console = Console()
    exported = Re3Run(settings, folder, find_device(device), console, resume is not None).run()
    for path in (exported.path, exported.path.with_suffix(".md")):
        print_line(console, str(path))


def export_command(
    folder: Annotated[Path, typer.Argument(help="Of a training of Re3, with its checkpoint.")],
) -> None:
    """Write a training's network as it stands: NAME.onnx and its card; checks both agree."""
    from follower.training.extra import check_extra

    check_extra()
    import torch

    from follower.training.checkpoint import load_checkpoint
    from follower.training.re3.run import finished, learnt_from
    from follower.training.re3.trainer import Re3Trainer

    config, device = _config(folder / "config.yaml", [], None), torch.device("cpu")
    state = load_checkpoint(folder, device)
    torch.set_num_threads(config.training.threads)
    trainer = Re3Trainer(config.training, learnt_from(config, folder), device)
    trainer.restore(state)
    exported = finished(trainer, config, folder, trainer.validate())
    typer.echo(f"{exported.path}\nsha256 {exported.sha256}")


def _config(path: Path | None, overrides: list[str], pictures: Path | None) -> Re3Config:
    from follower.configs import configs_folder
    from follower.settings import settings_data
    from follower.training.re3.config import Re3Config
    from follower_control.strict_yaml import parse

    said, source = settings_data(
        path or configs_folder() / "train" / "re3.yaml", overrides=overrides
    )
    if pictures is not None:
        said["pictures"] = str(pictures)
    return parse(Re3Config, said, source)
