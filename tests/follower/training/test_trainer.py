"""The training loop, whatever it trains."""

import math
from pathlib import Path

import pytest
import torch
from torch import nn

from follower.training.settings import TrainingConfig, TrainingPlan
from follower.training.trainer import Trainer, load_checkpoint, train
from follower_control.common.strict_config import SettingsError


class DivergingTrainer(Trainer[nn.Linear]):
    """Loses its weights in the step after the third."""

    kind, figures, quality, largest_gradient = "diverging", ("loss",), "quality", 1.0

    def train_step(self) -> dict[str, float]:
        self.step_number += 1
        return {"loss": 1.0 if self.step_number <= 3 else math.nan}

    def validate(self) -> float:
        return 0.5


def test_a_training_that_diverges_ends_and_keeps_its_last_checkpoint(tmp_path: Path) -> None:
    plan = TrainingPlan(validate_every=2, save_every=1)
    trainer = DivergingTrainer(nn.Linear(1, 1), plan, steps=10)
    with pytest.raises(SettingsError, match=r"step 4: the loss is nan: .* smaller learning rate"):
        train(trainer, TrainingConfig(name="one"), tmp_path)
    assert load_checkpoint(tmp_path, torch.device("cpu"))["step"] == 3
