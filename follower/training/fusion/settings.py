"""What a file of configs/train says about fitting Fusion."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt
from pydantic.dataclasses import dataclass

from follower.training.settings import STRICT, TrainingConfig


@dataclass(frozen=True, slots=True, config=STRICT)
class FusionSetup:
    """A motion tracker and a detector whose runs are learnt from.

    Attributes:
        tracker: of `follower trackers`.
        detector: of `follower models list`; None is none.
    """

    tracker: str
    detector: str | None = None


@dataclass(frozen=True, slots=True, config=STRICT)
class FitSettings:
    """How the model is fitted to what runs wrote down.

    Attributes:
        hidden: units of the hidden layer.
        steps: of AdamW.
        batch: candidates a step.
        rate: learning rate at the start; it falls to nothing as a cosine.
        weight_decay: of AdamW.
        seed: of the first weights and of the batches.
    """

    hidden: PositiveInt = 12
    steps: PositiveInt = 3000
    batch: PositiveInt = 4096
    rate: PositiveFloat = 0.01
    weight_decay: NonNegativeFloat = 0.2
    seed: NonNegativeInt = 1


class FusionConfig(TrainingConfig):
    """A fit of Fusion for one family of motion trackers."""

    setups: Annotated[tuple[FusionSetup, ...], Field(min_length=1)] = (
        FusionSetup("nanotrack-v3", "yolox-nano"),
    )
    """All of one family: what comes before the hyphen in the first one's tracker."""
    rounds: PositiveInt = 3
    """How often every sequence is run, each time by the model of the round before."""
    folds: Annotated[int, Field(ge=2)] = 5
    """Sequences are dealt to so many folds; a model never runs or is scored on its own."""
    jobs: PositiveInt = 2
    """Processes."""
    fit: FitSettings = FitSettings()
