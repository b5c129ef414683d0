"""Trains the Siamese tracker, step by step; a step depends on its number and the weights alone."""

import math
from collections.abc import Iterator
from dataclasses import asdict
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional
from torch.utils.data import DataLoader

from follower.training.scenes.generator import SceneMaker
from follower.training.scenes.image_source import ImageSource
from follower.training.siamese.examples import Batch, Batches
from follower.training.siamese.network import SiameseAnswer, SiameseModule, places
from follower.training.siamese.settings import SiameseTrainingSettings
from follower.training.trainer import Trainer
from follower_vision.trackers.nanotrack import IN_FIRST_SHAPE

_WARM_UP = 200
_HELD_OUT = 1_000_003
_LEAST_HALF_PX = 6.0
_SPREAD_PX = 6.0
_LEAST_SCORE = 0.05
_LEAST_RATE = 0.01
CPU = torch.device("cpu")


class SiameseLoss(NamedTuple):
    """Parts of the loss, each a mean over the visible targets (empty: over all).

    Attributes:
        side: 1 - generalised IoU of the boxes at places inside the target (Rezatofighi et al.,
            CVPR 2019).
        score: quality focal loss of the scores there: they learn the overlap (Li et al.,
            "Generalized Focal Loss", NeurIPS 2020).
        empty: focal loss of the scores outside the target.
        place: cross-entropy of the places against the target's middle.
    """

    side: Tensor
    score: Tensor
    empty: Tensor
    place: Tensor

    @property
    def total(self) -> Tensor:
        """Return the weighted sum that is minimised."""
        return 1.5 * self.side + 2.0 * self.score + self.empty + 0.25 * self.place


def in_shape(answer: SiameseAnswer, shape: Tensor) -> SiameseAnswer:
    """Return an answer in pixels, of one whose sides are measured in the first box's shape.

    A square template does not say which shape the user drew: with it the network only has to tell
    how the target has changed.

    Args:
        answer: the network's, of N search crops.
        shape: (N, 2) width and height of the templates' boxes over their geometric mean.
    """
    return SiameseAnswer(answer.scores, answer.sides * shape.repeat(1, 2)[:, :, None, None])


def siamese_loss(answer: SiameseAnswer, box: Tensor, visible: Tensor) -> tuple[SiameseLoss, Tensor]:
    """Return the loss of one step, and the overlap of the box with the best score, (N,).

    Args:
        answer: about N targets.
        box: (N, 4) true centre from the crop's middle and sides, in pixels.
        visible: (N,) whether the target is visible; its box counts only then.
    """
    scores, sides = answer.scores.flatten(1), answer.sides.flatten(2).transpose(1, 2)
    at = places().to(box.device)
    half = box[:, None, 2:] / 2
    off = at[None] - box[:, None, :2]
    # Inside: half the target's ellipse, and the nearest place; outside: beyond the whole one.
    ellipse = (off / half.clamp_min(_LEAST_HALF_PX)).square().sum(dim=2)
    away = off.square().sum(dim=2)
    nearest = functional.one_hot(away.argmin(dim=1), len(at)).bool()
    shown = visible[:, None]
    inside = ((ellipse < 0.25) | nearest) & shown
    outside = ((ellipse > 1.0) | ~shown) & ~inside
    overlap, generalised = _overlaps(at, sides, box[:, None, :2] - half, box[:, None, :2] + half)
    share = inside.to(scores.dtype) / inside.sum(dim=1, keepdim=True).clamp_min(1)
    count = visible.sum().clamp_min(1)
    wanted, likely = overlap.detach(), torch.sigmoid(scores)
    right = functional.binary_cross_entropy_with_logits(
        scores, wanted.clamp(_LEAST_SCORE, 1.0), reduction="none"
    )
    wrong = functional.binary_cross_entropy_with_logits(
        scores, torch.zeros_like(scores), reduction="none"
    )
    soft = torch.softmax(-away / (2 * _SPREAD_PX**2), dim=1)
    entropy = -(soft * functional.log_softmax(scores, dim=1)).sum(dim=1)
    loss = SiameseLoss(
        ((1 - generalised) * share).sum() / count,
        (right * (wanted - likely).abs().detach() * share).sum() / count,
        (wrong * likely.detach() ** 1.5 * outside).sum(dim=1).mean() / 4,
        (entropy * visible).sum() / count,
    )
    best = scores.argmax(dim=1, keepdim=True)
    return loss, overlap.gather(1, best)[:, 0].detach()


def _overlaps(
    at: Tensor, sides: Tensor, left_top: Tensor, right_bottom: Tensor
) -> tuple[Tensor, Tensor]:
    """Return IoU and generalised IoU, (N, P), of boxes about P places with the true ones."""
    first, last = at[None] - sides[..., :2], at[None] + sides[..., 2:]
    shared = torch.minimum(last, right_bottom) - torch.maximum(first, left_top)
    shared_px2 = shared.clamp_min(0).prod(dim=2)
    both = (last - first).prod(dim=2) + (right_bottom - left_top).prod(dim=2) - shared_px2
    overlap = shared_px2 / both.clamp_min(1.0)
    around = (torch.maximum(last, right_bottom) - torch.minimum(first, left_top)).prod(dim=2)
    return overlap, overlap - 1 + both / around.clamp_min(1.0)


class SiameseTrainer(Trainer[SiameseModule]):
    """The network, its optimiser and the number of steps done.

    Args:
        settings: the recipe.
        pictures: what the scenes are made of.
        device: where to compute.
    """

    kind = "siamese"
    figures = ("rate", "loss", *SiameseLoss._fields)
    quality = "overlap"
    largest_gradient = 5.0

    def __init__(
        self,
        settings: SiameseTrainingSettings,
        pictures: ImageSource,
        device: torch.device = CPU,
    ) -> None:
        torch.manual_seed(settings.seed)
        self.settings = settings
        self.device = device
        network = SiameseModule(settings.network).to(device)
        # Faster on a processor; torch's own types do not know this keyword.
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        size = asdict(settings.network) | dict([IN_FIRST_SHAPE])  # before, sides were in pixels
        super().__init__(network, settings, settings.steps, size)
        self._batches, self._held_out = (
            Batches(SceneMaker(pictures, settings.scenes, seed), settings.batch, frames)
            for frames in (settings.scene_frames,)
            for seed in (settings.seed, settings.seed + _HELD_OUT)
        )
        self._coming: Iterator[Batch] | None = None

    def train_step(self) -> dict[str, float]:
        """Learn from one batch; return the learning rate and the losses."""
        s = self.settings
        rise = min(1.0, (self.step_number + 1) / _WARM_UP)
        fall = 0.5 * (1.0 + math.cos(math.pi * (self.step_number + 1) / s.steps))
        rate = s.rate * rise * (_LEAST_RATE + (1.0 - _LEAST_RATE) * fall)
        self.network.train()
        loss, _ = self._loss(self.network, self._next())
        self._descend(loss.total, rate)
        parts = {name: float(value.detach()) for name, value in loss._asdict().items()}
        return {"rate": rate, "loss": float(loss.total.detach()), **parts}

    @torch.no_grad()
    def validate(self) -> float:
        """Return the mean overlap of the best box with visible targets of held-out scenes."""
        found: list[float] = []
        number = 0
        while len(found) < self.settings.held_out:
            batch = self._held_out[number]
            overlaps = self._loss(self.averaged, batch)[1]
            found += overlaps[batch.visible.to(self.device)].tolist()
            number += 1
        return sum(found) / len(found)

    def batch(self, number: int) -> Batch:
        """Return what a step learns from."""
        return self._batches[number]

    def _next(self) -> Batch:
        if self._coming is None:
            numbers = range(self.step_number, self.steps)
            loader = DataLoader(
                self._batches,
                batch_size=None,
                sampler=numbers,
                num_workers=self.settings.workers,
                multiprocessing_context="spawn" if self.settings.workers else None,
            )
            self._coming = iter(loader)
        return next(self._coming)

    def _loss(self, network: SiameseModule, batch: Batch) -> tuple[SiameseLoss, Tensor]:
        template, search = (
            crops.to(self.device).float().contiguous(memory_format=torch.channels_last)
            for crops in (batch.template, batch.search)
        )
        box, visible = batch.box.to(self.device), batch.visible.to(self.device)
        answer = in_shape(network(template, search), batch.shape.to(self.device))
        return siamese_loss(answer, box, visible)
