"""Crops and boxes that Re3 learns from, drawn from generated scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from follower.training.scenes.scene import Scene
from follower_vision.box import Box
from follower_vision.frame import Image
from follower_vision.re3_geometry import (
    SEARCH_PX,
    TEMPLATE_PX,
    relative_box,
    relative_size,
    search_region,
    template_region,
)

LEAST_VISIBLE = 0.3
_LEAST_SIDE_PX = 3.0
_REACH = 1.4
_TURNED_AWAY = 0.06


@dataclass(frozen=True, slots=True, eq=False)
class Example:
    """One target in one step.

    Attributes:
        memory: (64, 64, 3) crop about the target in the first frame.
        memory_size: its width and height in target scales.
        previous: (64, 64, 3) crop of the frame before about the last box.
        present: (128, 128, 3) crop of the new frame about the last box.
        size: the last box's width and height in target scales.
        answer: what the network should say.
        visible: whether the target is to be seen in `present`.
    """

    memory: Image
    memory_size: tuple[float, float]
    previous: Image
    present: Image
    size: tuple[float, float]
    answer: tuple[float, float, float, float]
    visible: bool


def pair(rng: np.random.Generator, scene: Scene) -> Example:
    """Return an example of three frames of a scene, the last two of them close together."""
    gap = int(rng.choice([1, 1, 2, 4]))
    frame = int(rng.integers(gap, scene.frames))
    first = int(rng.integers(scene.frames))
    last = strayed(rng, scene.drawn_box(frame - gap))
    memory, memory_size = remembered(scene, first)
    return looked(scene, (frame - gap, frame), last, memory, memory_size)


def remembered(scene: Scene, frame: int) -> tuple[Image, tuple[float, float]]:
    """Return the template crop about the target in a frame, and the target's relative size."""
    box = bounded(scene.drawn_box(frame))
    return scene.crop(frame, template_region(box), TEMPLATE_PX).image, relative_size(box)


def looked(
    scene: Scene,
    frames: tuple[int, int],
    last: Box,
    memory: Image,
    memory_size: tuple[float, float],
) -> Example:
    """Return what the network sees of two frames about the last box, and the right answer."""
    previous = scene.crop(frames[0], template_region(last), TEMPLATE_PX).image
    shot = scene.crop(frames[1], search_region(last), SEARCH_PX)
    answer = relative_box(bounded(scene.drawn_box(frames[1])), last)
    near = max(abs(answer[0]), abs(answer[1])) < _REACH
    return Example(
        memory,
        memory_size,
        previous,
        shot.image,
        relative_size(last),
        answer,
        shot.visible >= LEAST_VISIBLE and near,
    )


def strayed(rng: np.random.Generator, box: Box) -> Box:
    """Return a box as a tracker may have left it: mostly near the truth, sometimes far off."""
    far = rng.uniform() < 0.15
    shift = rng.uniform(-0.9, 0.9, 2) if far else rng.laplace(0.0, 0.08, 2)
    grown = np.exp(rng.laplace(0.0, 0.08, 2))
    return bounded(
        Box(
            box.cx + shift[0] * box.scale,
            box.cy + shift[1] * box.scale,
            box.width * grown[0],
            box.height * grown[1],
        )
    )


def bounded(box: Box) -> Box:
    """Return a box no smaller than a tracker allows."""
    return Box(box.cx, box.cy, max(box.width, _LEAST_SIDE_PX), max(box.height, _LEAST_SIDE_PX))


def swapped(rng: np.random.Generator, examples: Sequence[Example]) -> list[Example]:
    """Give some examples another one's picture, in which their target is not."""
    out = list(examples)
    for index, example in enumerate(examples):
        if rng.uniform() < _TURNED_AWAY:
            other = examples[(index + len(examples) // 2) % len(examples)]
            out[index] = Example(
                example.memory,
                example.memory_size,
                example.previous,
                other.present,
                example.size,
                example.answer,
                visible=False,
            )
    return out


def stacked(images: Sequence[Image]) -> npt.NDArray[np.uint8]:
    """Return images as one array (N, 3, h, w)."""
    return np.ascontiguousarray(np.stack(images).transpose(0, 3, 1, 2))
