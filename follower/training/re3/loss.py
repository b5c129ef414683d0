"""What a wrong answer of Re3 costs."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from follower.training.re3.network import Re3Answer
from follower_vision.re3_geometry import CELL_PX, TARGET_PX

_CELL = CELL_PX / TARGET_PX
_SPREAD = 0.8 * _CELL
_NEAR = 1.5 * _CELL
_MOST_LOG = 0.7


class Loss(NamedTuple):
    """Parts of the loss, each a mean over the targets in sight (confidence: over all).

    Attributes:
        place: cross-entropy of the places' scores.
        shape: of the boxes as seen from the places about the true middle.
        box: of the final box.
        seen: cross-entropy of the confidence.
    """

    place: Tensor
    shape: Tensor
    box: Tensor
    seen: Tensor

    @property
    def total(self) -> Tensor:
        """Return the weighted sum that is minimised."""
        return self.place + 5.0 * self.shape + 2.0 * self.box + 0.5 * self.seen


def re3_loss(answer: Re3Answer, wanted: Tensor, visible: Tensor, places: Tensor) -> Loss:
    """Return the loss of one step.

    Args:
        answer: about N targets.
        wanted: (N, 4) boxes as the network should say them.
        visible: (N,) whether the target is in sight; the box counts only then.
        places: (P, 2) of the network.
    """
    sight = visible.to(answer.box.dtype)
    count = sight.sum().clamp_min(1.0)
    logs = wanted[:, 2:].clamp(-_MOST_LOG, _MOST_LOG)
    offsets = wanted[:, None, :2] - places[None]
    away = offsets.square().sum(dim=2)
    soft = torch.softmax(-away / (2 * _SPREAD**2), dim=1)
    place = -(soft * functional.log_softmax(answer.scores, dim=1)).sum(dim=1)
    near = (away < _NEAR**2).to(sight.dtype)
    near = near / near.sum(dim=1, keepdim=True).clamp_min(1.0)
    target = torch.cat([offsets.transpose(1, 2), logs[:, :, None].expand(-1, -1, len(places))], 1)
    wrong = functional.smooth_l1_loss(answer.shapes, target, beta=0.02, reduction="none")
    shape = (wrong.mean(dim=1) * near).sum(dim=1)
    exact = torch.cat([wanted[:, :2], logs], dim=1)
    box = functional.smooth_l1_loss(answer.box, exact, beta=0.02, reduction="none").mean(dim=1)
    seen = functional.binary_cross_entropy_with_logits(answer.confidence, sight)
    return Loss(
        (place * sight).sum() / count,
        (shape * sight).sum() / count,
        (box.clamp_max(0.5) * sight).sum() / count,
        seen,
    )
