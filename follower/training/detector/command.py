"""The command `follower train detector`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from follower.command_options import Overrides
from follower.print_line import print_line
from follower.training.options import RUNS, Config, Device, Out, Resume

if TYPE_CHECKING:
    from follower.training.detector.config import DetectorConfig

EPILOG = """
**Examples**

`follower train detector` – one like the detector that comes along, from the simulator's scenes

`follower train detector --set training.steps=9000` – with more steps

`follower train detector --data my-drone/ --set name=my-drone` – your own target, from a folder in
YOLO's or COCO's form; then `follower fly … --set detector=runs/train/my-drone/my-drone.onnx`

`follower train detector --resume runs/train/my-drone` – go on where it was stopped

Look at samples.png before you wait for the rest, and at detections.png after it.
"""


def train_detector_command(
    config: Config = None,
    overrides: Overrides = None,
    data: Annotated[
        Path | None,
        typer.Option(help="Pictures of your own, in YOLO's form (a text file each) or COCO's."),
    ] = None,
    out: Out = RUNS,
    resume: Resume = None,
    start: Annotated[
        Path | None,
        typer.Option(
            help="Begin with the weights in another training's folder, or of a network that one "
            "has written (.onnx), of the same classes."
        ),
    ] = None,
    device: Device = "auto",
) -> None:
    """Train a small detector (YOLO v2's family) and write it as an ONNX file.

    Gives the network, its card with the quality on held-out pictures (mAP at an overlap of 0.5),
    the log, and pictures of what was learnt from and what is found. Half an hour on one core.
    """
    from follower.training.extra import check_extra

    check_extra()
    from rich.console import Console

    from follower.training.detector.run import TrainingRun
    from follower.training.device import find_device

    settings = _config(resume / "config.yaml" if resume else config, overrides or [], data)
    folder = resume or out / settings.name
    console = Console()
    run = TrainingRun(settings, folder, find_device(device), console, resume is not None, start)
    exported = run.run()
    for path in (exported.path, exported.card):
        print_line(console, str(path))


def _config(path: Path | None, overrides: list[str], data: Path | None) -> DetectorConfig:
    from follower.configs import configs_folder
    from follower.settings import settings_data
    from follower.training.detector.config import DetectorConfig
    from follower_control.strict_yaml import parse

    said, source = settings_data(
        path or configs_folder() / "train" / "detector.yaml", overrides=overrides
    )
    if data is not None:
        said["data"] = str(data)
        said["licence"] = "that of the pictures it learnt from"
    return parse(DetectorConfig, said, source)
