"""What Re3 learns from: crops and boxes of generated scenes, and tracking them frame by frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from follower.training.re3.network import Re3Answer, Re3Module, Re3ModuleState
from follower.training.scenes.scene import LEAST_VISIBLE, Scene, bounded
from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.trackers.re3 import (
    SEARCH_PX,
    TEMPLATE_PX,
    absolute_box,
    relative_box,
    relative_size,
    search_region,
    template_region,
)

_REACH = 1.4
_TURNED_AWAY = 0.06
_LOST_OVERLAP = 0.05


class Example(NamedTuple):
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
    return looked(scene, (frame - gap, frame), last, *remembered(scene, first))


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
    """Return a box in pixels as a tracker may have left it: mostly near the truth."""
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


def swapped(rng: np.random.Generator, examples: Sequence[Example]) -> list[Example]:
    """Give some examples a neighbour's picture, of another scene, in which their target is not."""
    out = list(examples)
    for index, example in enumerate(examples):
        if rng.uniform() < _TURNED_AWAY:
            other = examples[index - 1 if index else min(1, len(examples) - 1)]
            out[index] = example._replace(present=other.present, visible=False)
    return out


def stacked(images: Sequence[Image]) -> npt.NDArray[np.uint8]:
    """Return images as one array (N, 3, h, w)."""
    return np.ascontiguousarray(np.stack(images).transpose(0, 3, 1, 2))


class Batch:
    """Examples as tensors on a device.

    Attributes:
        wanted: (N, 4) right answers.
        visible: (N,) bool.
    """

    def __init__(self, examples: Sequence[Example], device: torch.device) -> None:
        """Stack the examples."""
        columns = zip(*examples, strict=True)
        memory, memory_size, previous, present, size, answer, visible = columns
        self.memory, self.previous, self.present = (
            torch.from_numpy(stacked(images)).to(device).float()
            for images in (memory, previous, present)
        )
        self.memory_size, self.size, self.wanted = (
            torch.tensor(rows, dtype=torch.float32, device=device)
            for rows in (memory_size, size, answer)
        )
        self.visible = torch.tensor(visible, device=device)


def answered(network: Re3Module, batch: Batch, memory: Tensor, state: Re3ModuleState) -> Re3Answer:
    """Return the network's answer to a batch."""
    answer: Re3Answer = network(
        network.memory(batch.previous), batch.present, batch.size, memory, batch.memory_size, state
    )
    return answer


class Rollout:
    """Several scenes, one frame after the other."""

    def __init__(self, network: Re3Module, scenes: Sequence[Scene], device: torch.device) -> None:
        """Show the network the first frame of each scene, as a tracker does at its start."""
        self._network = network
        self._scenes = scenes
        self._device = device
        self._memories = [remembered(scene, 0) for scene in scenes]
        self.boxes = [bounded(scene.drawn_box(0)) for scene in scenes]
        self.frame = 0
        crops = stacked([image for image, _ in self._memories])
        self.memory = network.memory(torch.from_numpy(crops).to(device).float())
        self.state = network.start_state(len(scenes))
        self._look(0)

    def step(self, stride: int = 1) -> tuple[Re3Answer, Batch]:
        """Show the next frame; `boxes` are then where the network saw the targets."""
        answer, batch = self._look(stride)
        self.frame += stride
        return answer, batch

    def _look(self, stride: int) -> tuple[Re3Answer, Batch]:
        frames = (self.frame, self.frame + stride)
        examples = [
            looked(scene, frames, box, *memory)
            for scene, box, memory in zip(self._scenes, self.boxes, self._memories, strict=True)
        ]
        batch = Batch(examples, self._device)
        answer = answered(self._network, batch, self.memory, self.state)
        self.state = answer.state
        found = answer.box.detach().cpu().numpy()
        self.boxes = [
            bounded(absolute_box(row, box)) for row, box in zip(found, self.boxes, strict=True)
        ]
        return answer, batch

    def correct(self, rng: np.random.Generator, own: Sequence[bool]) -> None:
        """Put a box back near the truth where it may not go on from the network's own.

        A target that was lost is put back too: nothing can be learnt from where it is not.
        """
        for index, scene in enumerate(self._scenes):
            truth = scene.drawn_box(self.frame)
            if not own[index] or self.boxes[index].iou(truth) < _LOST_OVERLAP:
                self.boxes[index] = strayed(rng, truth)


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
def tracked(network: Re3Module, scenes: Sequence[Scene], device: torch.device) -> Tracked:
    """Track each scene from its first frame to its last, without help."""
    rollout = Rollout(network, scenes, device)
    logits: list[float] = []
    overlaps: list[float] = []
    for _ in range(min(scene.frames for scene in scenes) - 1):
        answer, _batch = rollout.step()
        found = zip(scenes, rollout.boxes, answer.confidence.tolist(), strict=True)
        for scene, box, logit in found:
            truth = scene.drawn_box(rollout.frame)
            if truth.visible_share(scene.width, scene.height) > 0.5:
                logits.append(logit)
                overlaps.append(box.iou(truth))
    return Tracked(np.array(logits), np.array(overlaps))
