"""Runs Re3 through several generated scenes at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from follower.training.re3.examples import (
    Example,
    bounded,
    looked,
    remembered,
    stacked,
    strayed,
)
from follower.training.re3.network import Re3Answer, Re3Network, Re3State
from follower.training.scenes.scene import Scene
from follower_vision.box import Box
from follower_vision.re3_geometry import absolute_box

_LOST_OVERLAP = 0.05


class Batch:
    """Examples as tensors on a device.

    Attributes:
        wanted: (N, 4) right answers.
        visible: (N,) bool.
    """

    def __init__(self, examples: Sequence[Example], device: torch.device) -> None:
        """Stack the examples."""

        def images(name: str) -> Tensor:
            array = stacked([getattr(example, name) for example in examples])
            return torch.from_numpy(array).to(device).float()

        def numbers(name: str) -> Tensor:
            rows = [getattr(example, name) for example in examples]
            return torch.tensor(rows, dtype=torch.float32, device=device)

        self.memory, self.previous, self.present = map(images, ("memory", "previous", "present"))
        self.memory_size, self.size = numbers("memory_size"), numbers("size")
        self.wanted = numbers("answer")
        self.visible = torch.tensor([example.visible for example in examples], device=device)


def answered(network: Re3Network, batch: Batch, memory: Tensor, state: Re3State) -> Re3Answer:
    """Return the network's answer to a batch."""
    answer: Re3Answer = network(
        batch.previous, batch.present, batch.size, memory, batch.memory_size, state
    )
    return answer


class Rollout:
    """Several scenes, one frame after the other."""

    def __init__(self, network: Re3Network, scenes: Sequence[Scene], device: torch.device) -> None:
        """Show the network the first frame of each scene, as a tracker does at its start."""
        self._network = network
        self._scenes = scenes
        self._device = device
        self._memories = [remembered(scene, 0) for scene in scenes]
        self.boxes = [bounded(scene.drawn_box(0)) for scene in scenes]
        self.frame = 0
        self.memory = network.memory(self._first_crops())
        self.state = network.start_state(len(scenes))
        self._look(0)

    def _first_crops(self) -> Tensor:
        array = stacked([image for image, _ in self._memories])
        return torch.from_numpy(array).to(self._device).float()

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

    def overlaps(self) -> list[float | None]:
        """Return each target's overlap with the truth; None where it is out of sight."""
        return [
            _overlap(scene, self.frame, box)
            for scene, box in zip(self._scenes, self.boxes, strict=True)
        ]


def _overlap(scene: Scene, frame: int, box: Box) -> float | None:
    truth = scene.drawn_box(frame)
    return box.iou(truth) if truth.visible_share(scene.width, scene.height) > 0.5 else None
