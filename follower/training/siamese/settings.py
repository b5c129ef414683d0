"""How the Siamese tracker is trained: what configs/train/siamese.yaml says."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

from pydantic import Field, NonNegativeInt, PositiveFloat, PositiveInt
from pydantic.dataclasses import dataclass

from follower.training.scenes.generator import SceneSettings
from follower.training.settings import STRICT, TrackerTrainingConfig, TrackerTrainingPlan

_Units = Annotated[int, Field(ge=8)]


@dataclass(frozen=True, slots=True, config=STRICT)
class SiameseNetworkSettings:
    """How large the network is.

    Attributes:
        channels: of the backbone's features.
        head: channels of the maps after the correlation.
    """

    channels: _Units = 64
    head: _Units = 96


@dataclass(frozen=True, slots=True, config=STRICT)
class SiameseTrainingSettings(TrackerTrainingPlan):
    """Everything that decides how the weights come out.

    Attributes:
        steps: of the optimiser.
        batch: pairs of crops a step.
        rate: learning rate, after a warm-up; it falls to nothing as a cosine.
        network: its size.
        scenes: how hard they are.
        scene_frames: how long a scene is, from which pairs are taken.
        held_out: pairs of held-out scenes that a validation looks at.
        workers: processes that draw scenes; what is learnt does not depend on them.
    """

    steps: PositiveInt = 100
    batch: Annotated[int, Field(ge=2)] = 32
    rate: PositiveFloat = 2e-3
    network: SiameseNetworkSettings = field(default_factory=SiameseNetworkSettings)
    scenes: SceneSettings = field(default_factory=SceneSettings)
    scene_frames: PositiveInt = 48
    held_out: PositiveInt = 256
    workers: NonNegativeInt = 1


class SiameseConfig(TrackerTrainingConfig):
    """A training: what it is called, what it sees, and the recipe."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.-]*$")] = "follower-siamese"
    training: SiameseTrainingSettings = SiameseTrainingSettings()
