"""`follower train re3`: from a configuration to an ONNX file."""

from pathlib import Path

import cv2
import numpy as np
import torch
import typer

from follower.training.onnx_export import ExportedNetwork, write_card
from follower.training.re3.examples import Example, pair
from follower.training.re3.export import calibrated, export_re3
from follower.training.re3.network import Re3Module
from follower.training.re3.settings import Re3Config
from follower.training.re3.trainer import Re3Trainer
from follower.training.scenes.generator import SceneMaker
from follower.training.scenes.image_pool import load, prepare, rendered
from follower.training.scenes.image_source import ImageSource, procedural
from follower.training.scenes.scene import Scene
from follower.training.trainer import SAMPLES, open_folder, train
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.trackers.re3 import SEARCH_PX, TARGET_PX, TEMPLATE_PX, absolute_box

STOCK = "stock"
_WORLDS = 5
"""Separates the simulated worlds' random numbers from those of other things of the same seed."""
_ROWS = 6
_FRAMES = 24
_SHOWN = (0, 8, 16, 23)
_WHOLE_PX = (342, 256)
_FITTING, _DRAWN, _ANSWER = (80, 220, 60), (60, 170, 255), (80, 220, 60)


def train_re3(
    config: Re3Config,
    folder: Path,
    device: torch.device,
    resume: bool = False,
    network_type: type[Re3Module] = Re3Module,
) -> ExportedNetwork:
    """Train, measure and export.

    Args:
        config: what is trained.
        folder: where everything is written.
        device: where it computes.
        resume: go on from the folder's checkpoint.
        network_type: the network's class.

    Raises:
        SettingsError: the pictures or the checkpoint cannot be used.
    """
    training = config.training
    state = open_folder(config, training, folder, device, resume)
    if config.pictures is not None and not (folder / STOCK).is_dir():
        prepare(config.pictures, folder / STOCK, training.seed)
    pictures = image_source(config, folder)
    trainer = Re3Trainer(training, pictures, device, network_type)
    if state is None:
        maker = SceneMaker(pictures, training.scenes, training.seed)
        cv2.imwrite(str(folder / SAMPLES), sample_sheet(maker))
        typer.echo(f"{folder / SAMPLES}: look at it.")
    else:
        trainer.restore(state)
    train(trainer, folder)
    return finish(trainer, config, folder)


def image_source(config: Re3Config, folder: Path) -> ImageSource:
    """Return what the scenes of a training are made of: prepared pictures and rendered ones."""
    seed, worlds, stock = config.training.seed, config.training.worlds, folder / STOCK
    pictures = load(stock, seed) if stock.is_dir() else procedural(np.random.default_rng(seed))
    return pictures.joined(rendered(np.random.default_rng((seed, _WORLDS)), worlds))


def finish(trainer: Re3Trainer, config: Re3Config, folder: Path) -> ExportedNetwork:
    """Write the network of a training and its card, NAME.onnx and NAME.md."""
    calibration = calibrated(trainer.track_held_out(1))
    exported = export_re3(trainer.averaged, folder / f"{config.name}.onnx", calibration)
    training = config.training
    scenes = f"{training.validation_scenes} of {training.validation_frames} frames"
    rows = [
        ("data", config.data),
        ("recipe", f"{trainer.step_number} steps, AdamW, seed {training.seed}"),
        *(
            (
                "stage",
                f"{stage.steps} steps of {stage.batch} targets, {stage.unroll} frames, "
                f"rate {stage.rate:g}, own boxes {stage.own_boxes:g}",
            )
            for stage in training.stages
        ),
        ("mean overlap, held-out scenes", f"{trainer.validate():.3f} ({scenes})"),
    ]
    about = (
        "A motion tracker: a small Re3 (Gordon, Farhadi, Fox, RA-L 2018), with departures that\n"
        "docs/how-to/train-re3.md lists."
    )
    write_card(exported, config, trainer.averaged, about, rows)
    return exported


def sample_sheet(maker: SceneMaker) -> Image:
    """Return scenes with their boxes, and beside them what the network gets to see.

    Left, whole frames: green fits the mask, orange is the box to be followed. Right, examples of
    the same scene: memory, previous crop and present crop with the right answer.
    """
    return np.asarray(np.vstack([_row(maker.scene(index, _FRAMES)) for index in range(_ROWS)]))


def _row(scene: Scene) -> Image:
    rng = np.random.default_rng(0)
    wholes = [_whole(scene, frame) for frame in _SHOWN]
    examples = [_example(pair(rng, scene)) for _ in range(2)]
    return np.asarray(np.hstack([*wholes, *examples]))


def _whole(scene: Scene, frame: int) -> Image:
    image = scene.whole(frame).image.copy()
    _draw(image, scene.box(frame), _FITTING)
    _draw(image, scene.drawn_box(frame), _DRAWN)
    return np.asarray(cv2.resize(image, _WHOLE_PX, interpolation=cv2.INTER_AREA), np.uint8)


def _example(example: Example) -> Image:
    """Return memory above previous, beside present, 192 x 256 with a margin below."""
    width, height = (TARGET_PX * float(side) for side in example.size)
    last = Box(SEARCH_PX / 2, SEARCH_PX / 2, width, height)
    present = example.present.copy()
    if example.visible:
        box = absolute_box(np.array(example.answer, np.float32), last)
        _draw(present, box, _ANSWER, 1)
    small = np.vstack([example.memory, example.previous])
    both = np.hstack([small, present])
    blank = np.full((_WHOLE_PX[1] - SEARCH_PX, SEARCH_PX + TEMPLATE_PX, 3), 255, np.uint8)
    return np.asarray(np.vstack([both, blank]))


def _draw(image: Image, box: Box, colour: tuple[int, int, int], thickness: int = 2) -> None:
    first, last = (round(box.left), round(box.top)), (round(box.right), round(box.bottom))
    cv2.rectangle(image, first, last, colour, thickness, cv2.LINE_AA)
