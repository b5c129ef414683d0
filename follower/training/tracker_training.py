"""The training of a motion tracker, from a recipe to ONNX files, whatever its network."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import torch

from follower.training.onnx_export import ExportedNetwork
from follower.training.scenes.image_pool import image_source
from follower.training.scenes.image_source import ImageSource
from follower.training.settings import TrackerTrainingConfig
from follower.training.trainer import Trainer, open_training, show_samples, train
from follower_vision.images.frame import Image

ConfigT = TypeVar("ConfigT", bound=TrackerTrainingConfig)
TrainerT = TypeVar("TrainerT", bound=Trainer[Any])


@dataclass(frozen=True, slots=True)
class TrackerTraining(Generic[ConfigT, TrainerT]):
    """What a kind of motion tracker is trained by.

    Attributes:
        config_type: of its recipes.
        make_trainer: from a recipe's `training`, the pictures and the device.
        draw_samples: of what a trainer's network learns from.
        write: the networks of a training and their cards into a folder.
    """

    config_type: type[ConfigT]
    make_trainer: Callable[[Any, ImageSource, torch.device], TrainerT]
    draw_samples: Callable[[TrainerT], Image]
    write: Callable[[TrainerT, ConfigT, Path], list[ExportedNetwork]]

    def run(
        self, config: ConfigT, folder: Path, device: torch.device, resume: bool = False
    ) -> list[ExportedNetwork]:
        """Train, measure and export.

        Args:
            config: what is trained.
            folder: where everything is written.
            device: where it computes.
            resume: go on from the folder's checkpoint.

        Raises:
            SettingsError: the pictures or the checkpoint cannot be used.
        """
        trainer = self._begin(config, folder, device, resume)
        train(trainer, config, folder)
        return self.write(trainer, config, folder)

    def export(self, config: ConfigT, folder: Path) -> list[ExportedNetwork]:
        """Write the networks of the folder's checkpoint as they stand.

        Raises:
            SettingsError: the pictures or the checkpoint cannot be used.
        """
        trainer = self._begin(config, folder, torch.device("cpu"), resume=True)
        return self.write(trainer, config, folder)

    def _begin(self, config: ConfigT, folder: Path, device: torch.device, resume: bool) -> TrainerT:
        plan = config.training
        state = open_training(plan, folder, device, resume)
        pictures = image_source(
            config.pictures, folder, plan.seed, plan.worlds, plan.bodies, resume
        )
        trainer = self.make_trainer(plan, pictures, device)
        if state is not None:
            trainer.restore(state)
        else:
            show_samples(folder, self.draw_samples(trainer))
        return trainer
