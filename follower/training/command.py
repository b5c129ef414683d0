"""`follower train` and `follower export`: the package's own networks, or one for your target."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from follower.settings.settings import configs_folder, settings_data
from follower.training.settings import RUNS, TrainingConfig, find_device
from follower.ui.terminal.cli_options import Overrides
from follower.ui.terminal.console import check_extra
from follower_control.common.strict_config import SettingsError, parse

if TYPE_CHECKING:
    from follower.training.onnx_export import ExportedNetwork
    from follower.training.tracker_training import TrackerTraining

_DETECTOR_EPILOG = """
**Examples**

`follower train detector` – one like the detector that comes along, from the simulator's scenes

`follower train detector --set training.steps=9000` – with more steps

`follower train detector --data my-drone/ --set name=my-drone` – your own target, from a folder in
YOLO's or COCO's form; then `follower fly … --set detector=runs/train/my-drone/my-drone.onnx`

`follower train detector --resume runs/train/my-drone` – go on where it was stopped

Look at samples.png before you wait for the rest, and at detections.png after it.
"""
_RE3_EPILOG = """
**Examples**

`follower train re3 --pictures pictures/` – the tracker that comes along; the head of
configs/train/pictures.yaml says how to get the pictures, and what licences they have

`follower train re3` – from procedural pictures alone: nothing to fetch, a weaker tracker

`follower train re3 --resume runs/train/follower-re3` – go on where it was stopped

Look at samples.png before you wait for the rest.
"""
_SIAMESE_EPILOG = """
**Examples**

`follower train siamese --pictures pictures/` – the tracker that comes along; the head of
configs/train/pictures.yaml says how to get the pictures, and what licences they have

`follower track clip.mp4 --tracker runs/train/follower-siamese/follower-siamese_head.onnx` – try
what came of it

Look at samples.png before you wait for the rest.
"""
EXPORT_EPILOG = """
**Example**

`follower export runs/train/follower-re3` – the network of its last checkpoint, as it stands
"""
_FUSION_EPILOG = """
**Examples**

`follower train fusion --sequences footage/` – each folder in it is one annotated sequence (any
layout that `follower evaluate` reads); then `follower track … --set
fusion.model=runs/train/fusion-nanotrack/fitted.json`

`follower train fusion --sequences otb/ --sequences mine/ --set fit.hidden=24` – a larger model

`follower train fusion -c configs/train/fusion-others.yaml --sequences footage/` – for the trackers
that come along
"""
_SEQUENCES_EPILOG = """
**Example**

`follower train sequences generated/ --stock runs/train/follower-re3/stock --count 100`, then
`follower evaluate generated/ --trackers re3,correlation`
"""

_Config = Annotated[
    Path | None,
    typer.Option(
        "--config",
        "-c",
        help="The recipe (YAML); otherwise the one named like the command in configs/train/.",
    ),
]
_Pictures = Annotated[
    Path | None,
    typer.Option(help="Folder into which the packages of pictures.yaml were unpacked."),
]
_Out = Annotated[Path, typer.Option(help="Folder in which each training gets its own.")]
_Resume = Annotated[
    Path | None, typer.Option(help="Go on with a training's folder, with its own recipe.")
]
_Device = Annotated[
    str, typer.Option(help="**auto** takes a GPU if there is one.", metavar="auto|cpu|cuda")
]

ConfigT = TypeVar("ConfigT", bound=TrainingConfig)

train_app = typer.Typer(
    help="Train the networks that come along, or one for your own target; needs the extra `train`.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)


@train_app.command("detector", epilog=_DETECTOR_EPILOG)
def _train_detector(
    config: _Config = None,
    overrides: Overrides = None,
    data: Annotated[
        Path | None,
        typer.Option(help="Pictures of your own, in YOLO's form (a text file each) or COCO's."),
    ] = None,
    out: _Out = RUNS,
    resume: _Resume = None,
    start: Annotated[
        Path | None,
        typer.Option(
            help="Begin with the weights in another training's folder, or of a network that one "
            "has written (.onnx), of the same classes."
        ),
    ] = None,
    device: _Device = "auto",
) -> None:
    """Train a small detector (YOLO v2's family) and write it as an ONNX file.

    Gives the network, its card with the quality on held-out pictures (mAP at an overlap of 0.5),
    the log, and pictures of what was learnt from and what is found. Half an hour on one core.
    """
    check_extra("training", "train", "torch", "onnx")
    from follower.training.detector.run import train_detector
    from follower.training.detector.settings import DetectorConfig

    if resume and start:
        raise SettingsError(
            f"--start {start}: this training goes on with its own weights; leave out --start, or "
            "--resume"
        )
    licence = None if data is None else "that of its pictures"
    settings, folder = _read_recipe(
        "detector", DetectorConfig, config, overrides, out, resume, data=data, licence=licence
    )
    _print_files(train_detector(settings, folder, find_device(device), resume is not None, start))


@train_app.command("re3", epilog=_RE3_EPILOG)
def _train_re3(
    config: _Config = None,
    overrides: Overrides = None,
    pictures: _Pictures = None,
    out: _Out = RUNS,
    resume: _Resume = None,
    device: _Device = "auto",
) -> None:
    """Train the motion tracker Re3 on generated sequences and write it as an ONNX file.

    Gives the network, its card, the log and a picture of what it learns from. About an hour on one
    core.
    """
    _train_tracker("re3", config, overrides, pictures, out, resume, device)


@train_app.command("siamese", epilog=_SIAMESE_EPILOG)
def _train_siamese(
    config: _Config = None,
    overrides: Overrides = None,
    pictures: _Pictures = None,
    out: _Out = RUNS,
    resume: _Resume = None,
    device: _Device = "auto",
) -> None:
    """Train the Siamese motion tracker on generated scenes and write it as two ONNX files.

    Gives the networks, their cards, the log and a picture of what it learns from. An hour and a
    half on two cores.
    """
    _train_tracker("siamese", config, overrides, pictures, out, resume, device)


def _train_tracker(
    kind: str,
    config: Path | None,
    overrides: list[str] | None,
    pictures: Path | None,
    out: Path,
    resume: Path | None,
    device: str,
) -> None:
    check_extra("training", "train", "torch", "onnx")
    training = _tracker_trainings()[kind]
    settings, folder = _read_recipe(
        kind, training.config_type, config, overrides, out, resume, pictures=pictures
    )
    _print_files(*training.run(settings, folder, find_device(device), resume is not None))


def _tracker_trainings() -> dict[str, TrackerTraining[Any, Any]]:
    from follower.training.re3.run import RE3
    from follower.training.siamese.run import SIAMESE

    return {"re3": RE3, "siamese": SIAMESE}


@train_app.command("fusion", epilog=_FUSION_EPILOG)
def _train_fusion(
    sequences: Annotated[
        list[Path], typer.Option(help="Folder of annotated sequences; may be given several times.")
    ],
    config: _Config = None,
    overrides: Overrides = None,
    folds: Annotated[
        Path | None,
        typer.Option(help="JSON file with each sequence's fold; otherwise they are dealt by name."),
    ] = None,
    choices: Annotated[
        Path | None,
        typer.Option(
            help="Folder of choices written down elsewhere, as by benchmarks/fusion_flights.py."
        ),
    ] = None,
    begin: Annotated[
        Path | None,
        typer.Option(
            help="Folder of an earlier fit with the same folds, whose models drive the first round."
        ),
    ] = None,
    out: _Out = RUNS,
) -> None:
    """Fit the probability by which Fusion chooses to annotated footage.

    Gives fitted.json, a model per fold, and how well targets are followed that the model had not
    seen. 50 sequences of 330 frames take three quarters of an hour on two cores.
    """
    check_extra("training", "train", "torch")
    from follower.training.fusion.settings import FusionConfig
    from follower.training.fusion.trainer import (
        FusionTrainer,
        read_choices,
        read_folds,
        sequence_folders,
    )

    settings, folder = _read_recipe("fusion", FusionConfig, config, overrides, out)
    places = sequence_folders(sequences)
    known = None if folds is None else read_folds(folds)
    elsewhere = () if choices is None else read_choices(choices)
    fitted = FusionTrainer(settings, places, folder, known, elsewhere, begin).train()
    for setup in settings.setups:
        figures = fitted.figures(setup)
        typer.echo(
            f"{setup.tracker} with {setup.detector or 'no detector'}, {len(places)} sequences out "
            f"of fold: success {figures['success']:.3f}, precision {figures['precision']:.3f}"
        )
    typer.echo(fitted.path)


def export_command(
    folder: Annotated[
        Path, typer.Argument(help="Of a training of a motion tracker, with its checkpoint.")
    ],
) -> None:
    """Write a training's networks as they stand, .onnx and card; checks that both agree."""
    check_extra("training", "train", "torch", "onnx")
    import torch

    from follower.training.trainer import load_checkpoint

    kind = str(load_checkpoint(folder, torch.device("cpu")).get("kind"))
    training = _tracker_trainings().get(kind)
    if training is None:
        raise SettingsError(f"{folder}: this is no training of a motion tracker")
    settings, _ = _read_recipe(kind, training.config_type, resume=folder)
    for one in training.export(settings, folder):
        typer.echo(f"{one.path}\nsha256 {one.sha256}")


@train_app.command("sequences", epilog=_SEQUENCES_EPILOG)
def _write_sequences(
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

    from follower.training.scenes.generator import SceneMaker, SceneSettings, write_sequence
    from follower.training.scenes.image_pool import load, rendered
    from follower.training.scenes.image_source import procedural

    pictures = procedural(np.random.default_rng(seed)) if stock is None else load(stock, seed)
    pictures = pictures.joined(rendered(np.random.default_rng(seed), worlds))
    maker = SceneMaker(pictures, SceneSettings(), seed)
    for index in track(range(count), "sequences", transient=True):
        write_sequence(maker.scene(index, frames), out / f"generated_{index:03}")
    typer.echo(out)


def _read_recipe(
    kind: str,
    model: type[ConfigT],
    config: Path | None = None,
    overrides: Sequence[str] | None = None,
    out: Path = RUNS,
    resume: Path | None = None,
    **given: Path | str | None,
) -> tuple[ConfigT, Path]:
    """Return a training's configuration and folder; a resumed one has its own recipe.

    Args:
        kind: of training; without `config` the recipe is the one of this name.
        model: of the configuration.
        config: the recipe.
        overrides: `key=value`; they go before all else.
        out: in which the training gets its folder.
        resume: the folder of the training to go on with.
        **given: keys that options of their own give; None leaves the recipe's.

    Raises:
        SettingsError: names the file and the first wrong key, or `config` or `out` is another than
            that of the training to go on with.
    """
    own = resume and resume / "config.yaml"
    if resume and out not in (RUNS, resume.parent):
        raise SettingsError(
            f"--out {out}: this training goes on in {resume}; copy the folder to have it elsewhere"
        )
    path = own or config or configs_folder() / f"train/{kind}.yaml"
    data, source = settings_data(path, overrides=overrides or [])
    chosen = {text.partition("=")[0] for text in overrides or ()}
    more = {key: str(value) for key, value in given.items() if value and key not in chosen}
    settings = parse(model, data | more, source)
    if own and config:
        named, _ = _read_recipe(kind, model, config, overrides, out, None, **given)
        if settings != named:
            raise SettingsError(
                f"--config {config}: this training goes on with {own}, which says otherwise; leave "
                "out --config, and change single keys by --set"
            )
    return settings, resume or out / settings.name


def _print_files(*exported: ExportedNetwork) -> None:
    for one in exported:
        typer.echo(f"{one.path}\n{one.card}")
