"""How Re3 is trained: what configs/train/re3.yaml says."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from follower.training.re3.network import Re3NetworkSettings
from follower.training.scenes.settings import SceneSettings


@dataclass(frozen=True, slots=True)
class Stage:
    """One part of the training.

    Attributes:
        steps: optimiser steps.
        batch: targets a step.
        unroll: frames that the network runs through before it learns; 1: independent pairs of
            frames, without what the LSTM remembers.
        rate: learning rate, after a warm-up and before the last part's fall.
        own_boxes: share of the sequences that go on from the network's own boxes.
        trunk: whether the convolutions of the crops learn.
        recurrence_anew: the LSTM layers begin anew, without a say at first, and learn alone.
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    steps: int
    batch: int = 32
    unroll: int = 1
    rate: float = 1e-3
    own_boxes: float = 0.0
    trunk: bool = True
    recurrence_anew: bool = False

    def __post_init__(self) -> None:
        if min(self.steps, self.batch, self.unroll) < 1:
            raise ValueError("a stage needs at least one step, one target and one frame")
        if self.rate <= 0.0 or not 0.0 <= self.own_boxes <= 1.0:
            raise ValueError("a stage's rate must be positive, and own_boxes from 0 to 1")
        if self.recurrence_anew and self.unroll == 1:
            raise ValueError("recurrence is learnt from runs: unroll must be 2 or more")


@dataclass(frozen=True, slots=True)
class Re3TrainingSettings:
    """Everything that decides how the weights come out.

    Attributes:
        seed: of scenes, batches and first weights.
        stages: one after the other.
        network: its size.
        scenes: how hard they are.
        worlds: of the simulator, whose views and bodies join the pictures.
        weight_decay: of AdamW.
        average: share of the averaged weights that each step keeps.
        validate_every: steps between validations.
        validation_scenes: how many held-out scenes are tracked then.
        validation_frames: how long each is.
        save_every: steps between checkpoints.
        threads: processor threads of torch.
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    seed: int = 1
    stages: tuple[Stage, ...] = (Stage(steps=100),)
    network: Re3NetworkSettings = field(default_factory=Re3NetworkSettings)
    scenes: SceneSettings = field(default_factory=SceneSettings)
    worlds: int = 0
    weight_decay: float = 1e-4
    average: float = 0.998
    validate_every: int = 250
    validation_scenes: int = 16
    validation_frames: int = 24
    save_every: int = 250
    threads: int = 1

    def __post_init__(self) -> None:
        if not self.stages:
            raise ValueError("a training needs at least one stage")
        if self.worlds < 0:
            raise ValueError(f"worlds is a number of simulated worlds, not {self.worlds}")

    @property
    def steps(self) -> int:
        """Optimiser steps of all stages."""
        return sum(stage.steps for stage in self.stages)
