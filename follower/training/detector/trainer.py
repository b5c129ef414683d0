"""Trains a detector step by step; may be interrupted and resumed."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from follower.training.detector.average_precision import Precision, mean_average_precision
from follower.training.detector.labelled_image import AnswerReader, LabelledImage, TrainingImages
from follower.training.detector.loss import RegionLoss, make_labels
from follower.training.detector.network import RegionNetwork
from follower.training.detector.settings import DetectorTraining
from follower.training.trainer import Trainer
from follower_control.common.strict_config import SettingsError

_MEASURED_AT_ONCE = 32


class DetectorTrainer(Trainer[RegionNetwork]):
    """A network, its optimiser and its stream of pictures.

    A resumed training goes on from the same weights; its pictures are new ones, drawn from the seed
    and the step.

    Args:
        settings: the recipe.
        pictures: what to learn from.
        anchors: (A, 2) in cells.
        seed: of the weights and the pictures.
        device: where it computes.
    """

    kind = "detector"
    figures = ("loss", "learning_rate")
    quality = "mean_average_precision"
    largest_gradient = 10.0

    def __init__(
        self,
        settings: DetectorTraining,
        pictures: TrainingImages,
        anchors: np.ndarray,
        seed: int,
        device: torch.device,
    ) -> None:
        torch.manual_seed(seed)
        self.settings = settings
        self.anchors = np.asarray(anchors, np.float64)
        self.class_names = pictures.class_names
        network = RegionNetwork(len(self.class_names), len(anchors), settings.channels)
        super().__init__(network.to(device), settings, settings.steps)
        self.reader = AnswerReader(self.anchors, len(self.class_names), settings.side_px)
        self._pictures = pictures
        self._seed = seed
        self._device = device
        shapes = torch.tensor(self.anchors, dtype=torch.float32, device=device)
        self._loss = RegionLoss(shapes, settings.box_weight, settings.empty_weight)
        self._stream: Iterator[LabelledImage] | None = None

    @cached_property
    def held_out(self) -> list[LabelledImage]:
        """Pictures that no training sees."""
        return self._pictures.held_out(self.settings.side_px, self.settings.held_out_pictures)

    def train_step(self) -> dict[str, float]:
        """Learn from one batch; return the loss and the learning rate."""
        if self._stream is None:
            seed = self._seed + 1_000_003 * self.step_number
            self._stream = self._pictures.training(self.settings.side_px, seed)
        rate = self.learning_rate
        loss = self.learn([next(self._stream) for _ in range(self.settings.batch)])
        return {"loss": loss, "learning_rate": rate}

    def learn(self, batch: Sequence[LabelledImage]) -> float:
        """Learn from these pictures; return their loss."""
        self.network.train()
        labels = make_labels(batch, self.anchors, self._device)
        loss = self._loss(self.network(as_tensor(batch, self._device)), labels)
        self._descend(loss, self.learning_rate)
        return float(loss.detach())

    @property
    def learning_rate(self) -> float:
        """The rate of the next step."""
        settings = self.settings
        warm = min(1.0, (self.step_number + 1) / max(1, settings.warmup_steps))
        share = min(1.0, self.step_number / settings.steps)
        return settings.learning_rate * warm * (0.01 + 0.99 * (1 + math.cos(math.pi * share)) / 2)

    def validate(self) -> float:
        """Return the mean average precision on held-out pictures, 0 to 1."""
        return self.measure(self.held_out).mean or 0.0

    def measure(self, pictures: Sequence[LabelledImage]) -> Precision:
        """Return the averaged network's quality on pictures that it has not seen."""
        found = [self.reader.read(answer) for answer in self.answers(pictures)]
        return mean_average_precision(found, pictures, len(self.class_names))

    @torch.no_grad()
    def answers(self, pictures: Sequence[LabelledImage]) -> Iterator[np.ndarray]:
        """Yield the averaged network's answer to each picture."""
        for start in range(0, len(pictures), _MEASURED_AT_ONCE):
            some = pictures[start : start + _MEASURED_AT_ONCE]
            yield from self.averaged(as_tensor(some, self._device)).cpu().numpy()

    def state(self) -> dict[str, Any]:
        """Return all that a resumption needs."""
        return super().state() | {
            "anchors": self.anchors.tolist(),
            "classes": list(self.class_names),
            "settings": asdict(self.settings),
        }

    def begin_with(self, state: dict[str, Any]) -> None:
        """Take the weights of another training's state, and nothing else of it.

        Raises:
            SettingsError: it belongs to another network.
        """
        self.check(state)
        self.network.load_state_dict(state["averaged"])
        self.averaged.load_state_dict(state["averaged"])

    def check(self, state: dict[str, Any]) -> None:
        """Make sure that a state is of this network and these classes."""
        same = state.get("kind") == self.kind and state["classes"] == list(self.class_names)
        if not same or tuple(state["settings"]["channels"]) != tuple(self.settings.channels):
            raise SettingsError("the checkpoint is of another network or of other classes")


def as_tensor(pictures: Sequence[LabelledImage], device: torch.device) -> Tensor:
    """Return pictures as the network takes them: (B, 3, H, W) RGB, 0 to 1."""
    stacked = torch.from_numpy(np.stack([one.image for one in pictures])).to(device)
    return stacked.flip(3).permute(0, 3, 1, 2).float() / 255
