"""What a file of configs/train says about a detector's training."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, ConfigDict, Field

from follower.training.detector.folder_settings import FolderSettings
from follower.training.detector.rendered import RenderedPictures
from follower.training.detector.settings import DetectorTraining


class DetectorConfig(BaseModel):
    """A training: what it is called, what it sees, and the recipe."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.-]*$")] = "detector"
    """Of the exported files."""
    licence: str = "not stated"
    """Of the weights, for the model card."""
    seed: Annotated[int, Field(ge=0)] = 1
    """Of the weights at first, and of the pictures' order."""
    data: Path | None = None
    """The user's own pictures, in YOLO's or COCO's form; None renders the simulator's scenes."""
    folder: FolderSettings = FolderSettings()
    """How they are used."""
    rendered: RenderedPictures = RenderedPictures()
    """How the simulator's scenes are made."""
    training: DetectorTraining = DetectorTraining()

    def to_yaml(self) -> str:
        """Return the configuration as resolved, in the form in which it is read."""
        data: dict[str, Any] = self.model_dump(mode="json")
        return yaml.safe_dump(data, sort_keys=False)
