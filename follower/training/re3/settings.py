"""How Re3 is trained: what configs/train/re3.yaml says."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

from pydantic import Field, PositiveFloat, PositiveInt
from pydantic.dataclasses import dataclass

from follower.training.scenes.generator import SceneSettings
from follower.training.settings import STRICT, Share, TrackerTrainingConfig, TrackerTrainingPlan

_Units = Annotated[int, Field(ge=8)]


@dataclass(frozen=True, slots=True, config=STRICT)
class Re3NetworkSettings:
    """How large the network is.

    Attributes:
        channels: of the trunk's features.
        hidden: units of each LSTM layer.
        head: channels of the maps after the correlation.
    """

    channels: _Units = 64
    hidden: _Units = 192
    head: _Units = 64


@dataclass(frozen=True, slots=True, config=STRICT)
class TrainingStage:
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

    steps: PositiveInt
    batch: PositiveInt = 32
    unroll: PositiveInt = 1
    rate: PositiveFloat = 1e-3
    own_boxes: Share = 0.0
    trunk: bool = True
    recurrence_anew: bool = False

    def __post_init__(self) -> None:
        if self.recurrence_anew and self.unroll == 1:
            raise ValueError("recurrence is learnt from runs: unroll must be 2 or more")


@dataclass(frozen=True, slots=True, config=STRICT)
class Re3TrainingSettings(TrackerTrainingPlan):
    """Everything that decides how the weights come out.

    Attributes:
        stages: one after the other.
        network: its size.
        scenes: how hard they are.
        validation_scenes: how many held-out scenes are tracked in a validation.
        validation_frames: how long each is.
    """

    stages: Annotated[tuple[TrainingStage, ...], Field(min_length=1)] = (TrainingStage(steps=100),)
    network: Re3NetworkSettings = field(default_factory=Re3NetworkSettings)
    scenes: SceneSettings = field(default_factory=SceneSettings)
    validation_scenes: PositiveInt = 16
    validation_frames: Annotated[int, Field(ge=2)] = 24


class Re3Config(TrackerTrainingConfig):
    """A training: what it is called, what it sees, and the recipe."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.-]*$")] = "follower-re3"
    training: Re3TrainingSettings = Re3TrainingSettings()
