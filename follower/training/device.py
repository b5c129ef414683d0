"""Where a training computes."""

from __future__ import annotations

import torch

from follower_control.strict_yaml import SettingsError


def find_device(name: str) -> torch.device:
    """Return the device named "cpu", "cuda" or "cuda:1"; "auto" is a GPU if there is one.

    Raises:
        SettingsError: torch knows no such device, or cannot use it here.
    """
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
    except RuntimeError:
        raise SettingsError(f"--device {name}: use auto, cpu, cuda or cuda:1") from None
    if device.type == "cuda" and not torch.cuda.is_available():
        raise SettingsError(f"--device {name}: torch finds no GPU here; use cpu")
    return device
