"""Settings of a detector's training."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from follower_vision.detection.yolov2 import STRIDE

_LEAST_SIDE = 3 * STRIDE


@dataclass(frozen=True, slots=True)
class DetectorTraining:
    """The network's size, the recipe of its training, and the measure at the end.

    Attributes:
        side_px: of the square input; a multiple of 32.
        channels: of the network at strides 2, 4, 8, 16 and 32.
        anchors: how many boxes a cell predicts; YOLO v2 has five.
        steps: optimiser steps.
        batch: pictures a step.
        learning_rate: the largest; it rises over the first steps and falls as a cosine to zero.
        warmup_steps: over which it rises.
        weight_decay: of AdamW.
        average: share of the moving average of the weights, which is what is exported, kept a step.
        box_weight: of the boxes' part of the loss.
        empty_weight: of the objectness where nothing is.
        anchor_pictures: from which the anchors are taken by k-means.
        held_out_pictures: on which the quality is measured.
        validate_every: steps between two measurements on the held-out pictures.
        save_every: steps between two checkpoints.
        threads: processor threads.
    """

    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    side_px: int = 256
    channels: tuple[int, int, int, int, int] = (16, 24, 48, 96, 192)
    anchors: int = 5
    steps: int = 6000
    batch: int = 16
    learning_rate: float = 1.8e-3
    warmup_steps: int = 60
    weight_decay: float = 5e-4
    average: float = 0.995
    box_weight: float = 2.0
    empty_weight: float = 1.0
    anchor_pictures: int = 300
    held_out_pictures: int = 400
    validate_every: int = 500
    save_every: int = 50
    threads: int = 1

    def __post_init__(self) -> None:
        if self.side_px % STRIDE or self.side_px < _LEAST_SIDE:
            raise ValueError(f"side_px is a multiple of {STRIDE} from {_LEAST_SIDE} on")
        if min(self.channels) < 4 or any(count % 4 for count in self.channels):
            raise ValueError(f"channels are multiples of 4, not {self.channels}")
        for name in ("anchors", "steps", "batch", "validate_every", "save_every", "threads"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is at least 1, not {getattr(self, name)}")
        for name in ("warmup_steps", "anchor_pictures", "held_out_pictures"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is at least 0, not {getattr(self, name)}")
        if not 0 < self.learning_rate < math.inf:
            raise ValueError(f"learning_rate is positive, not {self.learning_rate}")
        for name in ("weight_decay", "box_weight", "empty_weight"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} must not be negative, not {getattr(self, name)}")
        if not 0 <= self.average < 1:
            raise ValueError(f"average lies from 0 to 1, not {self.average}")
