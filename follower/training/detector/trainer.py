"""Trains a detector step by step; may be interrupted and resumed."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from follower.training.detector.labelled_image import (
    IGNORED,
    AnswerReader,
    LabelledImage,
    Numbers,
    TrainingImages,
)
from follower.training.detector.loss import RegionLoss, make_labels
from follower.training.detector.network import RegionNetwork
from follower.training.detector.settings import DetectorTraining
from follower.training.trainer import Trainer
from follower_control.common.strict_config import SettingsError
from follower_vision.detection.detection import Candidates
from follower_vision.geometry.box import pairwise_iou

MATCH_IOU = 0.5


@dataclass(frozen=True, slots=True)
class Precision:
    """How well a detector does on held-out pictures.

    Attributes:
        mean: of the classes that occur, 0 to 1; None if none does.
        of_class: average precision of each class, None where the class does not occur.
        objects: how many objects each class has.
    """

    mean: float | None
    of_class: tuple[float | None, ...]
    objects: tuple[int, ...]


def mean_average_precision(
    found: Sequence[Candidates], truth: Sequence[LabelledImage], classes: int
) -> Precision:
    """Compare detections with the truth as PASCAL VOC (2010 and later) does.

    Args:
        found: of each picture, after overlapping boxes were removed.
        truth: the pictures; a detection on an ignored box counts neither way.
        classes: how many there are.
    """
    each = [_of_class(found, truth, number) for number in range(classes)]
    measured = [value for value, _ in each if value is not None]
    mean = float(np.mean(measured)) if measured else None
    return Precision(mean, tuple(v for v, _ in each), tuple(count for _, count in each))


def _of_class(
    found: Sequence[Candidates], truth: Sequence[LabelledImage], number: int
) -> tuple[float | None, int]:
    objects = sum(int((one.classes == number).sum()) for one in truth)
    if not objects:
        return None, 0
    pairs = zip(found, truth, strict=True)
    judged = [one for pair in pairs for one in _judged(*pair, number)]
    judged.sort(key=lambda one: -one[0])
    return average_precision(np.array([hit for _, hit in judged], bool), objects), objects


def _judged(
    candidates: Candidates, picture: LabelledImage, number: int
) -> list[tuple[float, bool]]:
    """Return score and right or wrong of each detection that counts, in one picture."""
    mine = np.flatnonzero(candidates.classes == number)
    mine = mine[np.argsort(-candidates.scores[mine], kind="stable")]
    wanted = picture.boxes[picture.classes == number]
    ignored = picture.boxes[picture.classes == IGNORED]
    free = np.ones(len(wanted), bool)
    judged = []
    for place in mine.tolist():
        corners, score = candidates.corners[place : place + 1], float(candidates.scores[place])
        overlaps = pairwise_iou(corners, wanted)[0] * free
        if overlaps.max(initial=0) >= MATCH_IOU:
            free[overlaps.argmax()] = False
            judged.append((score, True))
        elif pairwise_iou(corners, ignored).max(initial=0) < MATCH_IOU:
            judged.append((score, False))
    return judged


def average_precision(hits: Numbers | np.ndarray, objects: int) -> float:
    """Return the area under the precision-recall curve.

    Args:
        hits: (N,) whether each detection is right, the best score first.
        objects: how many were to be found, at least 1.
    """
    right = np.cumsum(hits)
    precision = right / np.arange(1, len(hits) + 1)
    recall = right / objects
    best_from_here = np.maximum.accumulate(precision[::-1])[::-1]
    steps = np.diff(np.concatenate([[0.0], recall]))
    return float((steps * best_from_here).sum())


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

    Attributes:
        begun_with: the name of the other training whose weights it began with, "" if none.
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
        self.begun_with = ""

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
            "begun_with": self.begun_with,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """See `Trainer`."""
        super().restore(state)
        self.begun_with = str(state.get("begun_with", ""))

    def begin_with(self, state: dict[str, Any], name: str) -> None:
        """Take the weights of another training's state, and nothing else of it.

        Args:
            state: of the other training.
            name: by which the model card tells of it.

        Raises:
            SettingsError: it belongs to another network.
        """
        self.check(state)
        self.network.load_state_dict(state["averaged"])
        self.averaged.load_state_dict(state["averaged"])
        self.begun_with = name

    def check(self, state: dict[str, Any]) -> None:
        """Make sure that a state is of this network and these classes."""
        same = state.get("kind") == self.kind and state["classes"] == list(self.class_names)
        if not same or tuple(state["settings"]["channels"]) != tuple(self.settings.channels):
            raise SettingsError("the checkpoint is of another network or of other classes")


def as_tensor(pictures: Sequence[LabelledImage], device: torch.device) -> Tensor:
    """Return pictures as the network takes them: (B, 3, H, W) RGB, 0 to 1."""
    stacked = torch.from_numpy(np.stack([one.image for one in pictures])).to(device)
    return stacked.flip(3).permute(0, 3, 1, 2).float() / 255
