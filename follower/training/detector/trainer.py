"""Trains a detector step by step; may be interrupted and resumed."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from torch import Tensor

from follower.training.detector.average_precision import Precision, mean_average_precision
from follower.training.detector.labelled import LabelledImage, Pictures
from follower.training.detector.loss import RegionLoss, make_labels
from follower.training.detector.network import RegionNetwork
from follower.training.detector.reading import AnswerReader
from follower.training.detector.settings import DetectorTraining
from follower_control.strict_yaml import SettingsError

_LARGEST_GRADIENT = 10.0
_MEASURED_AT_ONCE = 32


class DetectorTrainer:
    """A network, its optimiser and its stream of pictures.

    The weights that are measured and exported are a moving average of those being trained. A
    resumed training goes on from the same weights; its pictures are new ones, drawn from the seed
    and the step.

    Args:
        settings: the recipe.
        pictures: what to learn from.
        anchors: (A, 2) in cells.
        seed: of the weights and the pictures.
        device: where it computes.
    """

    def __init__(
        self,
        settings: DetectorTraining,
        pictures: Pictures,
        anchors: np.ndarray,
        seed: int,
        device: torch.device,
    ) -> None:
        torch.manual_seed(seed)
        self.settings = settings
        self.anchors = np.asarray(anchors, np.float64)
        self.class_names = pictures.class_names
        self.step_number = 0
        self._pictures = pictures
        self._seed = seed
        self._device = device
        count = len(self.class_names)
        self._network = RegionNetwork(count, len(anchors), settings.channels).to(device)
        self.averaged = copy.deepcopy(self._network).eval()
        shapes = torch.tensor(self.anchors, dtype=torch.float32, device=device)
        self._loss = RegionLoss(shapes, settings.box_weight, settings.empty_weight)
        self._optimiser = torch.optim.AdamW(
            self._network.parameters(), settings.learning_rate, weight_decay=settings.weight_decay
        )
        self._stream: Iterator[LabelledImage] | None = None

    def step(self) -> float:
        """Learn from one batch; return its loss."""
        if self._stream is None:
            seed = self._seed + 1_000_003 * self.step_number
            self._stream = self._pictures.training(self.settings.side_px, seed)
        return self.learn([next(self._stream) for _ in range(self.settings.batch)])

    def learn(self, batch: Sequence[LabelledImage]) -> float:
        """Learn from these pictures; return their loss."""
        for group in self._optimiser.param_groups:
            group["lr"] = self.learning_rate
        self._network.train()
        labels = make_labels(batch, self.anchors, self._device)
        loss = self._loss(self._network(as_tensor(batch, self._device)), labels)
        self._optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self._network.parameters(), _LARGEST_GRADIENT)
        self._optimiser.step()
        self.step_number += 1
        self._average()
        return float(loss.detach())

    @property
    def learning_rate(self) -> float:
        """The rate of the next step."""
        settings = self.settings
        warm = min(1.0, (self.step_number + 1) / max(1, settings.warmup_steps))
        share = min(1.0, self.step_number / settings.steps)
        return settings.learning_rate * warm * (0.01 + 0.99 * (1 + math.cos(math.pi * share)) / 2)

    @torch.no_grad()
    def _average(self) -> None:
        """Let the averaged weights follow, quickly at first."""
        kept = min(self.settings.average, self.step_number / (self.step_number + 9))
        fresh = self._network.state_dict()
        for name, value in self.averaged.state_dict().items():
            if value.is_floating_point():
                value.lerp_(fresh[name], 1 - kept)
            else:
                value.copy_(fresh[name])

    @torch.no_grad()
    def measure(self, pictures: Sequence[LabelledImage]) -> Precision:
        """Return the averaged network's quality on pictures that it has not seen."""
        side = self.settings.side_px
        reader = AnswerReader(self.anchors, len(self.class_names), side)
        found = []
        for start in range(0, len(pictures), _MEASURED_AT_ONCE):
            some = pictures[start : start + _MEASURED_AT_ONCE]
            answers = self.averaged(as_tensor(some, self._device)).cpu().numpy()
            found += [reader.read(answer) for answer in answers]
        return mean_average_precision(found, pictures, len(self.class_names))

    def state(self) -> dict[str, Any]:
        """Return all that a resumption needs."""
        return {
            "kind": "detector",
            "step": self.step_number,
            "network": self._network.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "anchors": self.anchors.tolist(),
            "classes": list(self.class_names),
            "settings": asdict(self.settings),
        }

    def begin_with(self, state: dict[str, Any]) -> None:
        """Take the weights of another training's state, and nothing else of it.

        Raises:
            SettingsError: it belongs to another network.
        """
        self._check(state)
        self._network.load_state_dict(state["averaged"])
        self.averaged.load_state_dict(state["averaged"])

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state.

        Raises:
            SettingsError: it belongs to another network.
        """
        self._check(state)
        self._network.load_state_dict(state["network"])
        self.averaged.load_state_dict(state["averaged"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.step_number = int(state["step"])

    def _check(self, state: dict[str, Any]) -> None:
        same = state.get("kind") == "detector" and state["classes"] == list(self.class_names)
        if not same or tuple(state["settings"]["channels"]) != tuple(self.settings.channels):
            raise SettingsError("the checkpoint is of another network or of other classes")


def as_tensor(pictures: Sequence[LabelledImage], device: torch.device) -> Tensor:
    """Return pictures as the network takes them: (B, 3, H, W) RGB, 0 to 1."""
    stacked = torch.from_numpy(np.stack([one.image for one in pictures])).to(device)
    return stacked.flip(3).permute(0, 3, 1, 2).float() / 255
