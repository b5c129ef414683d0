"""Generated scenes in which nothing is hard, and how a tiny training on them is interrupted."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from follower.training.scenes.generator import SceneSettings
from follower.training.trainer import load_checkpoint, save_checkpoint

EASY = SceneSettings(
    least_scale=40,
    most_scale=60,
    motion=0.1,
    perspective=0.0,
    deformation=0.0,
    occlusion=0.0,
    look_alikes=0.0,
    leaving=0.0,
    blur=0.0,
    low_light=0.0,
    pieces=0.0,
    loose=0.0,
)


def check_interrupted(make: Callable[[], Any], folder: Path) -> None:
    """Train through, and with another trainer from a checkpoint on: the weights are the same."""
    through, first, resumed = make(), make(), make()
    while not through.done:
        through.train_step()
    for _ in range(2):
        first.train_step()
    save_checkpoint(folder, first.state())
    resumed.restore(load_checkpoint(folder, torch.device("cpu")))
    while not resumed.done:
        resumed.train_step()
    weights = zip(through.averaged.parameters(), resumed.averaged.parameters(), strict=True)
    assert all(torch.equal(one, other) for one, other in weights)
