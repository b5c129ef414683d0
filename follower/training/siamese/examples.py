"""What the Siamese tracker learns from: a template and a search crop of a generated scene."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.utils.data import Dataset

from follower.training.scenes.generator import SceneMaker
from follower.training.scenes.scene import LEAST_VISIBLE, Scene, bounded
from follower.training.siamese.network import SEARCH_PX, TEMPLATE_PX
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.trackers.nanotrack import context_side

_TEMPLATE_VISIBLE = 0.5
_PAIRS_A_SCENE = 4
_NEAR_FRAMES = 6
_FAR_SHARE, _CENTRED_SHARE, _GREY_SHARE, _OTHER_SHARE = 0.6, 0.35, 0.15, 0.05
_AWAY_PX, _HARDLY_AWAY_PX = 44.0, 4.0
_ZOOM_SPREAD = 0.18
_RELIT_SHARE, _BLURRED_SHARE = 0.5, 0.1
_A_STEP = 4096
"""So many scenes a step has for itself."""


class Example(NamedTuple):
    """One target in two frames.

    Attributes:
        template: (80, 80, 3) crop about the target.
        search: (160, 160, 3) crop near the target in another frame.
        box: (4,) centre x, y from the search crop's middle, width and height there, in pixels.
        visible: whether the target is to be seen in it.
        shape: (2,) width and height of the template's box over their geometric mean.
    """

    template: Image
    search: Image
    box: npt.NDArray[np.float32]
    visible: bool
    shape: npt.NDArray[np.float32]


class Batch(NamedTuple):
    """Examples as tensors.

    Attributes:
        template: (N, 3, 80, 80) uint8.
        search: (N, 3, 160, 160) uint8.
        box: (N, 4), see `Example`.
        visible: (N,) bool.
        shape: (N, 2), see `Example`.
    """

    template: Tensor
    search: Tensor
    box: Tensor
    visible: Tensor
    shape: Tensor


class Batches(Dataset[Batch]):
    """Batch number `k` of a training, always the same one.

    Args:
        maker: of the scenes.
        batch: examples in each.
        frames: of each scene.
    """

    def __init__(self, maker: SceneMaker, batch: int, frames: int) -> None:
        self._maker, self._batch, self._frames = maker, batch, frames

    def __getitem__(self, number: int) -> Batch:
        """Draw it."""
        cv2.setNumThreads(1)
        rng = np.random.default_rng((self._maker.seed, number, 3))
        examples: list[Example] = []
        scene_number = number * _A_STEP
        while len(examples) < self._batch:
            scene = self._maker.scene(scene_number, self._frames)
            scene_number += 1
            found = (pair(rng, scene) for _ in range(_PAIRS_A_SCENE))
            examples += [one for one in found if one is not None]
        return stacked(rng, examples[: self._batch])


def pair(rng: np.random.Generator, scene: Scene) -> Example | None:
    """Return two frames of a scene, mostly far apart; None if the first shows too little."""
    frames = scene.frames
    first = int(rng.integers(frames))
    if rng.uniform() < _FAR_SHARE:
        second = int(rng.integers(frames))
    else:
        near = first + rng.integers(-_NEAR_FRAMES, _NEAR_FRAMES + 1)
        second = int(np.clip(near, 0, frames - 1))
    target = bounded(scene.drawn_box(first))
    side = context_side(target)
    template = scene.crop(first, Box(target.cx, target.cy, side, side), TEMPLATE_PX)
    if template.visible < _TEMPLATE_VISIBLE:
        return None
    shape = np.array([target.width, target.height], np.float32) / np.float32(target.scale)
    target = bounded(scene.drawn_box(second))
    zoom = TEMPLATE_PX / (context_side(target) * math.exp(rng.normal(0.0, _ZOOM_SPREAD)))
    centred = rng.uniform() < _CENTRED_SHARE
    right, down = (
        rng.laplace(0.0, _HARDLY_AWAY_PX, 2) if centred else rng.uniform(-_AWAY_PX, _AWAY_PX, 2)
    )
    side = SEARCH_PX / zoom
    region = Box(target.cx - right / zoom, target.cy - down / zoom, side, side)
    search = scene.crop(second, region, SEARCH_PX)
    box = np.array([right, down, target.width * zoom, target.height * zoom], np.float32)
    visible = search.visible >= LEAST_VISIBLE
    return Example(_relit(rng, template.image), _relit(rng, search.image), box, visible, shape)


def stacked(rng: np.random.Generator, examples: list[Example]) -> Batch:
    """Put examples together, some mirrored, some in black and white, some with another's search."""
    count = len(examples)
    templates, searches = (
        np.stack(images).astype(np.float32)
        for images in ([one.template for one in examples], [one.search for one in examples])
    )
    visible = np.array([one.visible for one in examples])
    other = rng.uniform(size=count) < _OTHER_SHARE
    searches[other] = np.roll(searches, -(count // 2), axis=0)[other]
    visible[other] = False
    grey, mirrored = rng.uniform(size=count) < _GREY_SHARE, rng.uniform(size=count) < 0.5
    boxes = np.stack([one.box for one in examples])
    boxes[mirrored, 0] *= -1
    for images in (templates, searches):
        images[grey] = images[grey].mean(axis=3, keepdims=True)
        images[mirrored] = images[mirrored, :, ::-1]
    return Batch(
        _as_tensor(templates),
        _as_tensor(searches),
        torch.from_numpy(boxes),
        torch.from_numpy(visible),
        torch.from_numpy(np.stack([one.shape for one in examples])),
    )


def _as_tensor(images: npt.NDArray[np.float32]) -> Tensor:
    """Return (N, h, w, 3) as (N, 3, h, w) uint8."""
    return torch.from_numpy(np.ascontiguousarray(images.transpose(0, 3, 1, 2)).astype(np.uint8))


def _relit(rng: np.random.Generator, image: Image) -> Image:
    """Return a crop in another light or out of focus, or as it is."""
    if rng.uniform() < _RELIT_SHARE:
        gain, offset = np.exp(rng.normal(0.0, 0.2)), rng.normal(0.0, 12.0)
        tint = np.exp(rng.normal(0.0, 0.08, 3))
        image = np.clip(image * (gain * tint) + offset, 0, 255).astype(np.uint8)
    if rng.uniform() < _BLURRED_SHARE:
        side = int(rng.choice([3, 5]))
        image = np.asarray(cv2.GaussianBlur(image, (side, side), 0), np.uint8)
    return image
