"""Trains Re3, step by step; a step depends on nothing but its number and the weights."""

from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from follower.training.re3.examples import Batch, Rollout, Tracked, answered, pair, swapped, tracked
from follower.training.re3.network import Re3Answer, Re3Module
from follower.training.re3.settings import Re3TrainingSettings, TrainingStage
from follower.training.scenes.generator import SceneMaker
from follower.training.scenes.image_source import ImageSource
from follower.training.trainer import Trainer
from follower_vision.trackers.re3 import CELL_PX, TARGET_PX

_CELL = CELL_PX / TARGET_PX
_SPREAD = 0.8 * _CELL
_NEAR = 1.5 * _CELL
_MOST_LOG = 0.7
_PAIRS_A_SCENE = 4
_PAIR_FRAMES = 24
_WARM_UP = 100
_FALL = 0.35
_HELD_OUT = 1_000_003
CPU = torch.device("cpu")


class Re3Loss(NamedTuple):
    """Parts of the loss, each a mean over the visible targets (confidence: over all).

    Attributes:
        place: cross-entropy of the places' scores.
        shape: of the boxes as seen from the places about the true middle.
        box: of the final box.
        seen: cross-entropy of the confidence.
    """

    place: Tensor
    shape: Tensor
    box: Tensor
    seen: Tensor

    @property
    def total(self) -> Tensor:
        """Return the weighted sum that is minimised."""
        return self.place + 5.0 * self.shape + 2.0 * self.box + 0.5 * self.seen


def re3_loss(answer: Re3Answer, wanted: Tensor, visible: Tensor, places: Tensor) -> Re3Loss:
    """Return the loss of one step.

    Args:
        answer: about N targets.
        wanted: (N, 4) boxes as the network should say them.
        visible: (N,) whether the target is visible; the box counts only then.
        places: (P, 2) of the network.
    """
    shown = visible.to(answer.box.dtype)
    count = shown.sum().clamp_min(1.0)
    logs = wanted[:, 2:].clamp(-_MOST_LOG, _MOST_LOG)
    offsets = wanted[:, None, :2] - places[None]
    away = offsets.square().sum(dim=2)
    soft = torch.softmax(-away / (2 * _SPREAD**2), dim=1)
    place = -(soft * functional.log_softmax(answer.scores, dim=1)).sum(dim=1)
    near = (away < _NEAR**2).to(shown.dtype)
    near = near / near.sum(dim=1, keepdim=True).clamp_min(1.0)
    target = torch.cat([offsets.transpose(1, 2), logs[:, :, None].expand(-1, -1, len(places))], 1)
    wrong = functional.smooth_l1_loss(answer.shapes, target, beta=0.02, reduction="none")
    shape = (wrong.mean(dim=1) * near).sum(dim=1)
    exact = torch.cat([wanted[:, :2], logs], dim=1)
    box = functional.smooth_l1_loss(answer.box, exact, beta=0.02, reduction="none").mean(dim=1)
    seen = functional.binary_cross_entropy_with_logits(answer.confidence, shown)
    return Re3Loss(
        (place * shown).sum() / count,
        (shape * shown).sum() / count,
        (box.clamp_max(0.5) * shown).sum() / count,
        seen,
    )


class Re3Trainer(Trainer[Re3Module]):
    """The network, its optimiser and the number of steps done.

    Args:
        settings: the recipe.
        pictures: what the scenes are made of.
        device: where to compute.
        network_type: the network's class.

    Attributes:
        maker: of the scenes that are learnt from.
    """

    kind = "re3"
    figures = ("stage", "rate", "loss", *Re3Loss._fields)
    quality = "overlap"
    largest_gradient = 5.0

    def __init__(
        self,
        settings: Re3TrainingSettings,
        pictures: ImageSource,
        device: torch.device = CPU,
        network_type: type[Re3Module] = Re3Module,
    ) -> None:
        torch.manual_seed(settings.seed)
        self.settings = settings
        self.device = device
        network = network_type(settings.network).to(device)
        # A fifth faster on a processor; torch's own types do not know this keyword.
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        steps = sum(stage.steps for stage in settings.stages)
        super().__init__(network, settings, steps, asdict(settings.network))
        self.maker = SceneMaker(pictures, settings.scenes, settings.seed)
        self._held_out = SceneMaker(pictures, settings.scenes, settings.seed + _HELD_OUT)

    def train_step(self) -> dict[str, float]:
        """Learn from one batch; return the stage's index, the learning rate and the losses."""
        index, stage, share = self._stage()
        rate = stage.rate * _rate_factor(share, stage.steps)
        if stage.recurrence_anew and share == 0.0:
            self._begin_recurrence_anew()
        self._set_mode(stage)
        loss = self._pairs(stage) if stage.unroll == 1 else self._sequences(stage)
        self._descend(loss.total, rate)
        parts = {name: float(value.detach()) for name, value in loss._asdict().items()}
        return {"stage": index, "rate": rate, "loss": float(loss.total.detach()), **parts}

    def validate(self) -> float:
        """Return the mean overlap on held-out scenes, tracked with the network's own boxes."""
        return float(self.track_held_out(0).overlaps.mean())

    def track_held_out(self, part: int) -> Tracked:
        """Track the scenes of one part of those held out."""
        count, frames = self.settings.validation_scenes, self.settings.validation_frames
        numbers = range(part * count, (part + 1) * count)
        scenes = [self._held_out.scene(number, frames) for number in numbers]
        return tracked(self.averaged, scenes, self.device)

    def _stage(self) -> tuple[int, TrainingStage, float]:
        """Return the present stage with its index, and the share of it that is done."""
        start = 0
        for index, stage in enumerate(self.settings.stages):
            if self.step_number < start + stage.steps:
                return index, stage, (self.step_number - start) / stage.steps
            start += stage.steps
        raise RuntimeError("the training is done")

    def _set_mode(self, stage: TrainingStage) -> None:
        """Let batch statistics be learnt from independent pairs alone."""
        self.network.train(stage.unroll == 1)
        self.network.requires_grad_(not stage.recurrence_anew)
        self.network.trunk.requires_grad_(stage.trunk and not stage.recurrence_anew)
        if stage.recurrence_anew:
            for part in self.network.recurrence():
                part.requires_grad_(True)

    @torch.no_grad()
    def _begin_recurrence_anew(self) -> None:
        """Wake gates that have shut for good; what the network says stays what it was."""
        torch.manual_seed(self.settings.seed)
        self.network.load_state_dict(self.averaged.state_dict())
        self.network.begin_recurrence()
        for part in self.network.recurrence():
            for parameter in part.parameters():
                self._optimiser.state.pop(parameter, None)
        self.averaged.load_state_dict(self.network.state_dict())

    def _pairs(self, stage: TrainingStage) -> Re3Loss:
        rng = np.random.default_rng((self.settings.seed, self.step_number, 1))
        count = max(2, -(-stage.batch // _PAIRS_A_SCENE))
        scenes = [self.maker.scene(self._number(index), _PAIR_FRAMES) for index in range(count)]
        examples = [pair(rng, scenes[index % count]) for index in range(stage.batch)]
        batch = Batch(swapped(rng, examples), self.device)
        memory = self.network.memory(batch.memory)
        state = self.network.start_state(stage.batch)
        answer = answered(self.network, batch, memory, state)
        return self._loss(answer, batch)

    def _sequences(self, stage: TrainingStage) -> Re3Loss:
        rng = np.random.default_rng((self.settings.seed, self.step_number, 2))
        stride = int(rng.choice([1, 1, 2]))
        frames = stride * stage.unroll + 1
        scenes = [self.maker.scene(self._number(index), frames) for index in range(stage.batch)]
        own = [bool(rng.uniform() < stage.own_boxes) for _ in scenes]
        rollout = Rollout(self.network, scenes, self.device)
        losses = []
        for _ in range(stage.unroll):
            rollout.correct(rng, own)
            answer, batch = rollout.step(stride)
            losses.append(self._loss(answer, batch))
        return Re3Loss(*(torch.stack(part).mean() for part in zip(*losses, strict=True)))

    def _loss(self, answer: Any, batch: Batch) -> Re3Loss:
        return re3_loss(answer, batch.wanted, batch.visible, self.network.places)

    def _number(self, index: int) -> int:
        """Return a scene's number that no other step uses."""
        return self.step_number * 4096 + index


def _rate_factor(share: float, steps: int) -> float:
    """Return the factor of the learning rate: a rise, a plateau and a cosine's fall."""
    rise = min(1.0, (share * steps + 1) / _WARM_UP)
    fall = max(0.0, (share - (1.0 - _FALL)) / _FALL)
    return rise * (0.02 + 0.98 * 0.5 * (1.0 + float(np.cos(np.pi * fall))))
