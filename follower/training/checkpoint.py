"""A training's state on disk, so that it can be interrupted at any time."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import torch

from follower_control.strict_yaml import SettingsError

NAME = "checkpoint.pt"


def save_checkpoint(folder: Path, state: dict[str, Any]) -> None:
    """Write a checkpoint as a whole or not at all.

    Args:
        folder: of the training.
        state: tensors, plain numbers and texts, in dicts and lists.
    """
    fresh = folder / f"{NAME}.part"
    torch.save(state, fresh)
    fresh.replace(folder / NAME)


def load_checkpoint(folder: Path, device: torch.device) -> dict[str, Any]:
    """Read the checkpoint of a training.

    Raises:
        SettingsError: there is none, or it is broken.
    """
    path = folder / NAME
    if not path.is_file():
        raise SettingsError(f"{path}: there is no checkpoint to go on from; leave out --resume")
    try:
        state: dict[str, Any] = torch.load(path, map_location=device, weights_only=True)
    except (RuntimeError, EOFError, pickle.UnpicklingError) as error:
        raise SettingsError(
            f"{path}: this is no checkpoint of ours, or it is broken ({type(error).__name__})"
        ) from error
    return state
