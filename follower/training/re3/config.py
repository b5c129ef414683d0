"""What a file of configs/train says about Re3's training."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, ConfigDict, Field

from follower.training.re3.settings import Re3TrainingSettings


class Re3Config(BaseModel):
    """A training: what it is called, what it sees, and the recipe."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.-]*$")] = "follower-re3"
    """Of the exported files."""
    licence: str = "not stated"
    """Of the weights, for the model card."""
    data: str = "not stated"
    """Where the pictures come from, for the model card."""
    pictures: Path | None = None
    """Into which the packages of pictures.yaml were unpacked; None makes procedural pictures."""
    training: Re3TrainingSettings = Re3TrainingSettings()

    def to_yaml(self) -> str:
        """Return the configuration as resolved, in the form in which it is read."""
        data: dict[str, Any] = self.model_dump(mode="json")
        return yaml.safe_dump(data, sort_keys=False)
