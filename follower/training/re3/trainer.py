"""Trains Re3, step by step; a step depends on nothing but its number and the weights."""

from __future__ import annotations

import copy
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils import clip_grad_norm_

from follower.training.re3.calibration import Tracked, tracked
from follower.training.re3.examples import pair, swapped
from follower.training.re3.loss import Loss, re3_loss
from follower.training.re3.network import Re3NetworkSettings
from follower.training.re3.peers import make_network
from follower.training.re3.rollout import Batch, Rollout, answered
from follower.training.re3.settings import Re3TrainingSettings, Stage
from follower.training.scenes.maker import SceneMaker
from follower.training.scenes.pictures import Pictures
from follower_control.strict_yaml import SettingsError

_PAIRS_A_SCENE = 4
_PAIR_FRAMES = 24
_MOST_GRADIENT = 5.0
_WARM_UP = 100
_FALL = 0.35
_HELD_OUT = 1_000_003
CPU = torch.device("cpu")
LOSSES = ("total", "place", "shape", "box", "seen")


@dataclass(frozen=True, slots=True)
class StepReport:
    """What a step came to.

    Attributes:
        step: its number.
        stage: its stage's index.
        rate: learning rate.
        losses: total, place, shape, box, seen.
    """

    step: int
    stage: int
    rate: float
    losses: dict[str, float]


class Re3Trainer:
    """The network, its optimiser and the number of steps done.

    What is measured and exported is a moving average of the weights being trained.
    """

    def __init__(
        self, settings: Re3TrainingSettings, pictures: Pictures, device: torch.device = CPU
    ) -> None:
        """Make an untrained network ready to learn.

        Args:
            settings: what to do.
            pictures: what the scenes are made of.
            device: where to compute.
        """
        torch.manual_seed(settings.seed)
        self.settings = settings
        self.device = device
        self.network = make_network(settings.network).to(self.device)
        # A fifth faster on a processor; torch's own types do not know this keyword.
        self.network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.averaged = copy.deepcopy(self.network).eval()
        self._optimiser = torch.optim.AdamW(
            self.network.parameters(), weight_decay=settings.weight_decay
        )
        self._maker = SceneMaker(pictures, settings.scenes, settings.seed)
        self._held_out = SceneMaker(pictures, settings.scenes, settings.seed + _HELD_OUT)
        self.step = 0

    @property
    def done(self) -> bool:
        """Whether all stages have run."""
        return self.step >= self.settings.steps

    def train_step(self) -> StepReport:
        """Learn from one batch."""
        index, stage, share = self._stage()
        rate = stage.rate * _rate_factor(share, stage.steps)
        for group in self._optimiser.param_groups:
            group["lr"] = rate
        if stage.recurrence_anew and share == 0.0:
            self._begin_recurrence_anew()
        self._set_mode(stage)
        self._optimiser.zero_grad(set_to_none=True)
        loss = self._pairs(stage) if stage.unroll == 1 else self._sequences(stage)
        loss.total.backward()  # type: ignore[no-untyped-call]
        clip_grad_norm_(self.network.parameters(), _MOST_GRADIENT)
        self._optimiser.step()
        self.step += 1
        self._average()
        return StepReport(self.step, index, rate, _numbers(loss))

    def validate(self) -> float:
        """Return the mean overlap on held-out scenes, tracked with the network's own boxes."""
        return float(self.track_held_out(0).overlaps.mean())

    def track_held_out(self, part: int) -> Tracked:
        """Track the scenes of one part of those held out."""
        count, frames = self.settings.validation_scenes, self.settings.validation_frames
        numbers = range(part * count, (part + 1) * count)
        scenes = [self._held_out.scene(number, frames) for number in numbers]
        return tracked(self.averaged, scenes, self.device)

    def state(self) -> dict[str, Any]:
        """Return all that a resumption needs."""
        return {
            "kind": "re3",
            "step": self.step,
            "network": self.network.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimiser": self._optimiser.state_dict(),
            "size": asdict(self.settings.network),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state, exactly as if there had been no interruption.

        Raises:
            SettingsError: it belongs to another network.
        """
        size = Re3NetworkSettings(**state["size"]) if state.get("kind") == "re3" else None
        if size != self.settings.network:
            raise SettingsError("the checkpoint is of another network, or of another size")
        self.network.load_state_dict(state["network"])
        self.averaged.load_state_dict(state["averaged"])
        self._optimiser.load_state_dict(state["optimiser"])
        self.step = int(state["step"])

    @torch.no_grad()
    def _average(self) -> None:
        """Let the averaged weights follow, quickly at first."""
        kept = min(self.settings.average, self.step / (self.step + 9))
        fresh = self.network.state_dict()
        for name, value in self.averaged.state_dict().items():
            if value.is_floating_point():
                value.lerp_(fresh[name], 1 - kept)
            else:
                value.copy_(fresh[name])

    def _stage(self) -> tuple[int, Stage, float]:
        """Return the present stage with its index, and the share of it that is done."""
        start = 0
        for index, stage in enumerate(self.settings.stages):
            if self.step < start + stage.steps:
                return index, stage, (self.step - start) / stage.steps
            start += stage.steps
        raise RuntimeError("the training is done")

    def _set_mode(self, stage: Stage) -> None:
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

    def _pairs(self, stage: Stage) -> Loss:
        rng = np.random.default_rng((self.settings.seed, self.step, 1))
        count = -(-stage.batch // _PAIRS_A_SCENE)
        scenes = [self._maker.scene(self._number(index), _PAIR_FRAMES) for index in range(count)]
        examples = [pair(rng, scenes[index % count]) for index in range(stage.batch)]
        batch = Batch(swapped(rng, examples), self.device)
        memory = self.network.memory(batch.memory)
        state = self.network.start_state(stage.batch)
        answer = answered(self.network, batch, memory, state)
        return self._loss(answer, batch)

    def _sequences(self, stage: Stage) -> Loss:
        rng = np.random.default_rng((self.settings.seed, self.step, 2))
        stride = int(rng.choice([1, 1, 2]))
        frames = stride * stage.unroll + 1
        scenes = [self._maker.scene(self._number(index), frames) for index in range(stage.batch)]
        own = [bool(rng.uniform() < stage.own_boxes) for _ in scenes]
        rollout = Rollout(self.network, scenes, self.device)
        losses = []
        for _ in range(stage.unroll):
            rollout.correct(rng, own)
            answer, batch = rollout.step(stride)
            losses.append(self._loss(answer, batch))
        return Loss(*(torch.stack(part).mean() for part in zip(*losses, strict=True)))

    def _loss(self, answer: Any, batch: Batch) -> Loss:
        return re3_loss(answer, batch.wanted, batch.visible, self.network.places)

    def _number(self, index: int) -> int:
        """Return a scene's number that no other step uses."""
        return self.step * 4096 + index


def _rate_factor(share: float, steps: int) -> float:
    """Return the factor of the learning rate: a rise, a plateau and a cosine's fall."""
    rise = min(1.0, (share * steps + 1) / _WARM_UP)
    fall = max(0.0, (share - (1.0 - _FALL)) / _FALL)
    return rise * (0.02 + 0.98 * 0.5 * (1.0 + float(np.cos(np.pi * fall))))


def _numbers(loss: Loss) -> dict[str, float]:
    parts: dict[str, Tensor] = {"total": loss.total, **loss._asdict()}
    return {name: float(value.detach()) for name, value in parts.items()}
