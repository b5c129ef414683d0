"""What a file of configs/train says about a detector's training."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt
from pydantic.dataclasses import dataclass

from follower.training.detector.random_scene import RenderedPictures
from follower.training.settings import STRICT, TrainingConfig, TrainingPlan
from follower_vision.detection.families import YOLOV2_STRIDE

_Channels = Annotated[int, Field(ge=4, multiple_of=4)]


@dataclass(frozen=True, slots=True, config=STRICT)
class DetectorTraining(TrainingPlan):
    """The network's size, the recipe of its training, and the measure at the end.

    Attributes:
        side_px: of the square input; a multiple of 32.
        channels: of the network at strides 2, 4, 8, 16 and 32.
        anchors: how many boxes a cell predicts; YOLO v2 has five.
        steps: optimiser steps.
        batch: pictures a step.
        learning_rate: the largest; it rises over the first steps and falls as a cosine to zero.
        warmup_steps: over which it rises.
        box_weight: of the boxes' part of the loss.
        empty_weight: of the objectness where nothing is.
        anchor_pictures: from which the anchors are taken by k-means.
        held_out_pictures: on which the quality is measured.
    """

    side_px: Annotated[int, Field(ge=3 * YOLOV2_STRIDE, multiple_of=YOLOV2_STRIDE)] = 256
    channels: tuple[_Channels, _Channels, _Channels, _Channels, _Channels] = (16, 24, 48, 96, 192)
    anchors: PositiveInt = 5
    steps: PositiveInt = 6000
    batch: PositiveInt = 16
    learning_rate: PositiveFloat = 1.8e-3
    warmup_steps: NonNegativeInt = 60
    weight_decay: NonNegativeFloat = 5e-4
    average: Annotated[float, Field(ge=0, lt=1)] = 0.995
    box_weight: NonNegativeFloat = 2.0
    empty_weight: NonNegativeFloat = 1.0
    anchor_pictures: NonNegativeInt = 300
    held_out_pictures: NonNegativeInt = 400
    validate_every: PositiveInt = 500
    save_every: PositiveInt = 50


@dataclass(frozen=True, slots=True, config=STRICT)
class FolderSettings:
    """How a folder of labelled pictures is used.

    Attributes:
        held_out_share: of the pictures, kept from training to measure the quality; used where the
            folder itself does not separate training from validation.
        views_a_picture: cut from a picture before the next one is read.
    """

    held_out_share: Annotated[float, Field(gt=0, lt=1)] = 0.2
    views_a_picture: PositiveInt = 3


class DetectorConfig(TrainingConfig):
    """A training: what it is called, what it sees, and the recipe."""

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.-]*$")] = "detector"
    seed: NonNegativeInt = 1
    """Of the weights at first, and of the pictures' order."""
    data: Path | None = None
    """The user's own pictures, in YOLO's or COCO's form; None renders the simulator's scenes."""
    folder: FolderSettings = FolderSettings()
    """How they are used."""
    rendered: RenderedPictures = RenderedPictures()
    """How the simulator's scenes are made."""
    training: DetectorTraining = DetectorTraining()
