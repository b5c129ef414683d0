"""`follower train re3`: from a configuration to an ONNX file."""

from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor, nn

from follower.training.onnx_export import (
    ExportedNetwork,
    export_network,
    folded,
    round_to_half,
    store_as_half,
    write_card,
)
from follower.training.re3.examples import Example, Tracked, pair
from follower.training.re3.network import Re3Module, Re3ModuleState
from follower.training.re3.settings import Re3Config
from follower.training.re3.trainer import Re3Trainer
from follower.training.scenes.generator import SceneMaker
from follower.training.scenes.scene import Scene
from follower.training.tracker_training import TrackerTraining
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.trackers.re3 import (
    INPUTS,
    OUTPUTS,
    SEARCH_PX,
    TARGET_PX,
    TEMPLATE_PX,
    absolute_box,
)

RIGHT_OVERLAP = 0.5
_NEWTON_STEPS = 30
_RIDGE = 1e-2
UNCALIBRATED = (1.0, 0.0)
"""Slope and offset of a logit that is left as it is."""


def calibrated(seen: Tracked) -> tuple[float, float]:
    """Fit the likelihood of an overlap above a half by a logistic curve (Platt's scaling).

    Returns slope and offset of the calibrated logit. Where the logits say nothing about the
    overlap, or the wrong thing, they are left as they are.
    """
    right = (seen.overlaps > RIGHT_OVERLAP).astype(float)
    inputs = np.stack([seen.logits, np.ones_like(seen.logits)], axis=1)
    weights = np.zeros(2)
    for _ in range(_NEWTON_STEPS):
        likelihood = 1.0 / (1.0 + np.exp(-np.clip(inputs @ weights, -30, 30)))
        slope = inputs.T @ (likelihood - right) + _RIDGE * weights
        curve = (inputs * (likelihood * (1 - likelihood))[:, None]).T @ inputs
        weights -= np.linalg.solve(curve + _RIDGE * np.eye(2), slope)
    if not np.isfinite(weights).all() or weights[0] <= 0.0:
        return UNCALIBRATED
    return float(weights[0]), float(weights[1])


class Re3Export(nn.Module):
    """The network with plain tensors in and out, in the order of `INPUTS` and `OUTPUTS`."""

    def __init__(self, network: Re3Module, calibration: tuple[float, float]) -> None:
        """Wrap a network."""
        super().__init__()
        self.network = network
        self.slope, self.offset = calibration

    def forward(
        self,
        previous: Tensor,
        present: Tensor,
        size: Tensor,
        memory: Tensor,
        memory_size: Tensor,
        hidden: Tensor,
        cell: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Return box, confidence, features of `previous`, and both parts of the new state."""
        features = self.network.memory(previous)
        answer = self.network(
            features, present, size, memory, memory_size, Re3ModuleState(hidden, cell)
        )
        seen = torch.sigmoid(self.slope * answer.confidence + self.offset)
        return answer.box, seen, features, answer.state.hidden, answer.state.cell


def export_re3(
    network: Re3Module, path: Path, calibration: tuple[float, float] = UNCALIBRATED
) -> ExportedNetwork:
    """Write the network to an ONNX file, its weights as 16-bit numbers, and compare the two.

    The comparison is with the network of the same rounded weights.

    Raises:
        ModelError: the file does not answer as the network does.
    """
    compact = folded(network)
    round_to_half(compact)
    return export_network(
        Re3Export(compact, calibration).eval(),
        path,
        lambda rng: random_inputs(network, rng),
        (INPUTS, (*OUTPUTS[:3], "next_hidden", "next_cell")),
        {"family": "re3", "licence": "Apache-2.0"},
        store_as_half,
    )


def random_inputs(network: Re3Module, rng: np.random.Generator) -> tuple[Tensor, ...]:
    """Return one set of inputs: crops of smooth noise, a memory and a state."""
    channels, hidden = network.settings.channels, network.settings.hidden

    def noise(*shape: int) -> Tensor:
        return torch.from_numpy(rng.normal(size=shape).astype(np.float32))

    cells = TEMPLATE_PX // 8
    return (
        (noise(1, 3, TEMPLATE_PX, TEMPLATE_PX) * 40 + 120).clamp(0, 255),
        (noise(1, 3, SEARCH_PX, SEARCH_PX) * 40 + 120).clamp(0, 255),
        torch.tensor([[1.2, 1 / 1.2]]),
        nn.functional.normalize(noise(1, channels, cells, cells), dim=1),
        torch.tensor([[0.8, 1.25]]),
        noise(2, 1, hidden) * 0.2,
        noise(2, 1, hidden) * 0.2,
    )


_ROWS = 6
_FRAMES = 24
_SHOWN = (0, 8, 16, 23)
_WHOLE_PX = (342, 256)
_FITTING, _DRAWN, _ANSWER = (80, 220, 60), (60, 170, 255), (80, 220, 60)


def write_re3(trainer: Re3Trainer, config: Re3Config, folder: Path) -> list[ExportedNetwork]:
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
    return [exported]


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


RE3 = TrackerTraining(Re3Config, Re3Trainer, lambda trainer: sample_sheet(trainer.maker), write_re3)
