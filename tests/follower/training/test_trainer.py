"""The training loop, whatever it trains."""

import math
from pathlib import Path

import pytest
import torch
from torch import nn

from follower.training.settings import TrainingConfig, TrainingPlan
from follower.training.trainer import Trainer, load_checkpoint, train
from follower_control.common.strict_config import SettingsError


class EndingTrainer(Trainer[nn.Linear]):
    """Does nothing, and ends in the fourth step: its loss is no number, or somebody interrupts."""

    kind, figures, quality, largest_gradient = "ending", ("loss",), "quality", 1.0

    def __init__(self, loss: float) -> None:
        super().__init__(nn.Linear(1, 1), TrainingPlan(validate_every=2, save_every=1), steps=10)
        self._loss = loss

    def train_step(self) -> dict[str, float]:
        self.step_number += 1
        if self.step_number <= 3:
            return {"loss": 1.0}
        if math.isnan(self._loss):
            return {"loss": self._loss}
        raise KeyboardInterrupt

    def validate(self) -> float:
        return 0.5


def test_a_training_that_diverges_ends_and_keeps_its_last_checkpoint(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"step 4: the loss is nan: .* smaller learning rate"):
        train(EndingTrainer(math.nan), TrainingConfig(name="one"), tmp_path)
    assert load_checkpoint(tmp_path, torch.device("cpu"))["step"] == 3


def test_an_interrupted_training_says_how_it_goes_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(KeyboardInterrupt):
        train(EndingTrainer(1.0), TrainingConfig(name="one"), tmp_path)
    said = f"interrupted; go on from the last checkpoint with --resume {tmp_path}"
    assert said in capsys.readouterr().out.splitlines()
