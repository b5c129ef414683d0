"""What every training's recipe has: its name, how often it measures, the device."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, NonNegativeInt, PositiveInt
from pydantic.dataclasses import dataclass

from follower_control.common.strict_config import SettingsError

if TYPE_CHECKING:
    import torch

STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)
Share = Annotated[float, Field(ge=0, le=1)]

RUNS = Path("runs/train")
"""Where trainings go unless `--out` says otherwise."""


@dataclass(frozen=True, slots=True, config=STRICT)
class TrainingPlan:
    """How often a training measures and saves, and how its weights are smoothed.

    Attributes:
        weight_decay: of AdamW.
        average: share of the averaged weights that each step keeps. The average is what is
            measured and exported.
        validate_every: steps between two measurements on held-out pictures.
        save_every: steps between two checkpoints.
        threads: processor threads of torch.
    """

    weight_decay: NonNegativeFloat = 1e-4
    average: Annotated[float, Field(ge=0, lt=1)] = 0.998
    validate_every: PositiveInt = 250
    save_every: PositiveInt = 250
    threads: PositiveInt = 1


@dataclass(frozen=True, slots=True, config=STRICT)
class TrackerTrainingPlan(TrainingPlan):
    """What the trainings of both motion trackers have besides.

    Attributes:
        seed: of scenes, batches and first weights.
        worlds: of the simulator, whose views and bodies join the pictures.
        bodies: seen from all sides, which turn.
    """

    seed: NonNegativeInt = 1
    worlds: NonNegativeInt = 0
    bodies: NonNegativeInt = 0


class TrainingConfig(BaseModel):
    """What a training is called, and the licence of its result."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.-]*$")]
    """Of the exported files."""
    licence: str = "not stated"
    """Of the weights, for the model card."""


class TrackerTrainingConfig(TrainingConfig):
    """A motion tracker's training: what it is called and what it sees."""

    data: str = "not stated"
    """Where the pictures come from, for the model card."""
    pictures: Path | None = None
    """Into which the packages of pictures.yaml were unpacked; None makes procedural pictures."""
    training: TrackerTrainingPlan


def find_device(name: str) -> torch.device:
    """Return the device named "cpu", "cuda" or "cuda:1"; "auto" is a GPU if there is one.

    Raises:
        SettingsError: torch knows no such device, or cannot use it here.
    """
    import torch

    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        torch.zeros(1, device=device).item()
    except (RuntimeError, AssertionError):  # the latter if torch was built without the device
        raise SettingsError(
            f"--device {name}: torch has none here; use auto, cpu, cuda or cuda:1"
        ) from None
    return device
