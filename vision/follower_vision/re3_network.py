"""Our Re3 network in an ONNX file: what goes in, what comes out, what is remembered."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from follower_vision.box import Box
from follower_vision.crop import crop
from follower_vision.frame import Image
from follower_vision.network import ModelError, Network, Tensor
from follower_vision.re3_geometry import (
    SEARCH_PX,
    TEMPLATE_PX,
    relative_size,
    search_region,
    template_region,
)

INPUTS = ("previous", "present", "size", "memory", "memory_size", "hidden", "cell")
OUTPUTS = ("box", "confidence", "features", "hidden", "cell")


@dataclass(frozen=True, slots=True, eq=False)
class Re3Memory:
    """What was learnt of the target when the track began.

    Attributes:
        features: (1, C, 8, 8) of its template crop.
        size: (1, 2) its width and height in target scales.
    """

    features: Tensor
    size: Tensor


@dataclass(frozen=True, slots=True, eq=False)
class Re3State:
    """What both LSTM layers carry from frame to frame, (2, 1, hidden) each."""

    hidden: Tensor
    cell: Tensor


@dataclass(frozen=True, slots=True, eq=False)
class Re3Output:
    """What the network says about one frame.

    Attributes:
        box: (4,) as `absolute_box` takes it.
        confidence: 0 to 1, the likelihood that the box is right (overlap above a half), as it was
            on generated sequences.
        features: of the view of the frame before.
        state: for the next frame.
    """

    box: Tensor
    confidence: float
    features: Tensor
    state: Re3State


class Re3Network:
    """Looks at two crops and says where the target is; several trackers may share it."""

    def __init__(self, path: Path, threads: int = 1) -> None:
        """Load the network.

        Raises:
            ModelError: the file is missing, broken or no Re3 network of ours.
        """
        self._network = Network(path, threads)
        if tuple(self._network.inputs) != INPUTS or len(self._network.outputs) != len(OUTPUTS):
            names = ", ".join(self._network.inputs)
            raise ModelError(f"{path}: not a Re3 network of ours: its inputs are {names}")
        self._no_features = np.zeros(self._network.inputs["memory"], np.float32)
        self._no_state = np.zeros(self._network.inputs["hidden"], np.float32)

    @property
    def first_state(self) -> Re3State:
        """What is remembered before anything was seen."""
        return Re3State(self._no_state, self._no_state)

    def view(self, image: Image, box: Box, fill: tuple[float, ...]) -> Image:
        """Return what a box shows, as the network wants to see it a frame later.

        Args:
            image: (H, W, 3) uint8 BGR.
            box: in pixels.
            fill: colour of what lies outside the image.
        """
        return crop(image, template_region(box), TEMPLATE_PX, TEMPLATE_PX, fill)

    def learn(self, image: Image, box: Box, fill: tuple[float, ...]) -> tuple[Re3Memory, Re3State]:
        """Return what there is to remember of a target in its first image."""
        view, blank = self.view(image, box, fill), Re3Memory(self._no_features, _size(box))
        features = self.look(view, image, box, fill, blank, self.first_state).features
        memory = Re3Memory(features, _size(box))
        return memory, self.look(view, image, box, fill, memory, self.first_state).state

    def look(
        self,
        view: Image,
        image: Image,
        box: Box,
        fill: tuple[float, ...],
        memory: Re3Memory,
        state: Re3State,
    ) -> Re3Output:
        """Look for the target about a place.

        Args:
            view: of the target in the frame before.
            image: (H, W, 3) uint8 BGR, the present frame.
            box: the place, in pixels, and the target's size.
            fill: colour of what lies outside the image.
            memory: of the target.
            state: after the frame before.
        """
        outputs = self._network.run(
            _tensor(view),
            _tensor(crop(image, search_region(box), SEARCH_PX, SEARCH_PX, fill)),
            _size(box),
            memory.features,
            memory.size,
            state.hidden,
            state.cell,
        )
        answer, confidence, features, hidden, cell = outputs
        return Re3Output(
            answer[0], float(confidence.reshape(-1)[0]), features, Re3State(hidden, cell)
        )


def _tensor(image: Image) -> Tensor:
    return np.ascontiguousarray(image.transpose(2, 0, 1)[None], dtype=np.float32)


def _size(box: Box) -> Tensor:
    return np.array([relative_size(box)], np.float32)
