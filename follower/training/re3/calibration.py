"""Turns the network's confidence into the likelihood that its box is right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from follower.training.re3.network import Re3Network
from follower.training.re3.rollout import Rollout
from follower.training.scenes.scene import Scene

RIGHT_OVERLAP = 0.5
_NEWTON_STEPS = 30
_RIDGE = 1e-2


@dataclass(frozen=True, slots=True)
class Calibration:
    """A logit becomes `slope * logit + offset`."""

    slope: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """What came of tracking scenes with the network's own boxes, target in the frame.

    Attributes:
        logits: (M,) of the confidence in each frame.
        overlaps: (M,) of the box with the truth.
    """

    logits: npt.NDArray[np.float64]
    overlaps: npt.NDArray[np.float64]


@torch.no_grad()
def tracked(network: Re3Network, scenes: Sequence[Scene], device: torch.device) -> Tracked:
    """Track each scene from its first frame to its last, without help."""
    rollout = Rollout(network, scenes, device)
    logits: list[float] = []
    overlaps: list[float] = []
    for _ in range(min(scene.frames for scene in scenes) - 1):
        answer, _batch = rollout.step()
        for logit, overlap in zip(answer.confidence.tolist(), rollout.overlaps(), strict=True):
            if overlap is not None:
                logits.append(logit)
                overlaps.append(overlap)
    return Tracked(np.array(logits), np.array(overlaps))


def calibrated(seen: Tracked) -> Calibration:
    """Fit the likelihood of an overlap above a half by a logistic curve (Platt's scaling).

    Where the logits say nothing about it, or the wrong thing, they are left as they are.
    """
    right = (seen.overlaps > RIGHT_OVERLAP).astype(float)
    inputs = np.stack([seen.logits, np.ones_like(seen.logits)], axis=1)
    weights = np.zeros(2)
    for _ in range(_NEWTON_STEPS):
        likelihood = 1.0 / (1.0 + np.exp(-np.clip(inputs @ weights, -30, 30)))
        slope = inputs.T @ (likelihood - right) + _RIDGE * weights
        curve = (inputs * (likelihood * (1 - likelihood))[:, None]).T @ inputs
        weights -= np.linalg.solve(curve + _RIDGE * np.eye(2), slope)
    if not np.isfinite(weights).all() or weights[0] <= 0.0:
        return Calibration()
    return Calibration(float(weights[0]), float(weights[1]))
