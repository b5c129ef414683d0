"""The interface of object detectors: an image in, boxes with classes out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Protocol

import numpy as np
import numpy.typing as npt

from follower_vision.geometry.box import Box
from follower_vision.images.frame import Image
from follower_vision.onnx_network import Tensor


@dataclass(frozen=True, slots=True)
class Detection:
    """One object that a detector sees.

    Attributes:
        box: in pixels of the whole image, also when only a region was looked at.
        class_id: the class's number in the detector's own list.
        class_name: e.g. "person".
        score: 0 to 1; comparable for one detector, not between detectors.
        cut: the box ends at the edge of the region looked at, so that the object may go on.
    """

    box: Box
    class_id: int
    class_name: str
    score: float
    cut: bool = False

    def moved(self, right_px: float, down_px: float) -> Detection:
        """Return the same at another place, `right_px` and `down_px` pixels away."""
        box = self.box.moved_to(self.box.cx + right_px, self.box.cy + down_px)
        return replace(self, box=box)


class Detector(Protocol):
    """Finds objects of known classes in an image; remembers nothing between images."""

    @property
    def class_names(self) -> tuple[str, ...]:
        """The names of all classes that it knows, by their numbers."""
        ...

    def detect(self, image: Image, region: Box | None = None) -> list[Detection]:
        """Return what is to be seen, best first.

        Args:
            image: (H, W, 3) uint8 BGR, which is not to be written into.
            region: search only here, enlarged; None is the whole image. It may reach beyond the
                image. An object counts where its centre lies within the region.
        """
        ...


@dataclass(frozen=True, slots=True)
class Candidates:
    """N boxes in pixels of the network's input.

    Attributes:
        corners: (N, 4) left, top, right, bottom.
        scores: (N,) 0 to 1.
        classes: (N,) class numbers.
    """

    corners: Tensor
    scores: Tensor
    classes: npt.NDArray[np.intp]

    def above(self, score: float) -> Candidates:
        """Return those with at least this score, 0 to 1."""
        return self._chosen(self.scores >= score)

    def valid(self) -> Candidates:
        """Return those that are finite and have an area."""
        finite = self._chosen(np.isfinite(self.corners).all(axis=1) & np.isfinite(self.scores))
        sides = finite.corners[:, 2:] - finite.corners[:, :2]
        return finite._chosen((sides > 0).all(axis=1))

    def _chosen(self, good: npt.ArrayLike) -> Candidates:
        rows = np.flatnonzero(good)
        return Candidates(self.corners[rows], self.scores[rows], self.classes[rows])


def from_centres(centres: Tensor, sizes: Tensor) -> Tensor:
    """Return corners, (N, 4), of boxes given by centre and size, each (N, 2)."""
    half = sizes / 2
    return np.hstack([centres - half, centres + half])


def best_class(scores: Tensor) -> tuple[Tensor, npt.NDArray[np.intp]]:
    """Return each row's largest value and its place, of (N, classes)."""
    classes = scores.argmax(axis=1)
    return np.take_along_axis(scores, classes[:, None], axis=1)[:, 0], classes


def sigmoid(values: Tensor) -> Tensor:
    """Return 1 / (1 + exp(-x)) without overflow."""
    return np.asarray(0.5 * (1.0 + np.tanh(0.5 * values)), dtype=np.float32)


def softmax(values: Tensor) -> Tensor:
    """Return the softmax over the last axis."""
    powers = np.exp(values - values.max(axis=-1, keepdims=True))
    return np.asarray(powers / powers.sum(axis=-1, keepdims=True), dtype=np.float32)


def grid_points(height: int, width: int) -> Tensor:
    """Return column and row of each cell of a grid, (height * width, 2), row by row."""
    across, down = np.meshgrid(np.arange(width), np.arange(height))
    return np.stack([across.ravel(), down.ravel()], axis=1).astype(np.float32)


@dataclass(frozen=True, slots=True)
class DetectorSettings:
    """Which of a network's answers count.

    Attributes:
        min_score: weaker detections are dropped, 0 to 1.
        max_overlap: largest intersection over union of two detections of one class, 0 to 1.
        most: how many detections are reported at most.
    """

    min_score: float = 0.3
    max_overlap: float = 0.45
    most: int = 100

    def __post_init__(self) -> None:
        for name in ("min_score", "max_overlap"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} must be from 0 to 1, not {getattr(self, name)}")
        if self.most < 1:
            raise ValueError(f"most must be at least 1, not {self.most}")


@dataclass(frozen=True, slots=True)
class NetworkLayout:
    """What goes into a detection network and comes out.

    Attributes:
        height: of the input, in pixels.
        width: of the input, in pixels.
        outputs: name and shape of every output, in order.
        anchors: widths and heights, in cells, that the file names; () if it names none.
        head: the last layer's kind, that the file names as Ultralytics does; "" if it does not.
    """

    height: int
    width: int
    outputs: tuple[tuple[str, tuple[int, ...]], ...]
    anchors: tuple[tuple[float, float], ...] = ()
    head: str = ""

    @property
    def only_output(self) -> tuple[int, ...]:
        """The shape of the output if there is one alone, else ()."""
        return self.outputs[0][1] if len(self.outputs) == 1 else ()

    def grid(self, stride: int) -> tuple[int, int]:
        """Return rows and columns of the grid of cells of `stride` pixels."""
        return math.ceil(self.height / stride), math.ceil(self.width / stride)

    def cells(self, strides: Sequence[int]) -> int:
        """Return the number of cells on all grids together."""
        return sum(math.prod(self.grid(stride)) for stride in strides)

    def __str__(self) -> str:
        outputs = ", ".join(f"{name} {shape}" for name, shape in self.outputs)
        return f"input {self.width}x{self.height}, outputs {outputs}"


class Placement(StrEnum):
    """How a region of another shape is fitted into the network's input."""

    STRETCH = "stretch"
    """Both sides are scaled on their own."""
    CENTRE = "centre"
    """The shape is kept; what is missing is added on both sides."""
    CORNER = "corner"
    """The shape is kept; what is missing is added to the right or below."""


@dataclass(frozen=True, slots=True)
class InputFormat:
    """What a network wants to be shown.

    Attributes:
        placement: how a region of another shape is fitted in.
        fill: the grey value of what lies outside the image.
        red_first: channels are red, green, blue; otherwise blue, green, red.
        mean: of each channel, in the network's order, taken off.
        deviation: by which each channel is divided after that.
    """

    placement: Placement
    fill: float = 114.0
    red_first: bool = False
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    deviation: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def view(self, region: Box, width: int, height: int) -> Box:
        """Return the part of the image that fills an input of `width` x `height` pixels."""
        if self.placement is Placement.STRETCH:
            return region
        zoom = min(width / region.width, height / region.height)
        if self.placement is Placement.CENTRE:
            return Box(region.cx, region.cy, width / zoom, height / zoom)
        return Box.from_xywh(region.left, region.top, width / zoom, height / zoom)

    def write(self, cut: Image, tensor: Tensor) -> None:
        """Write an image of the input's size, (H, W, 3) BGR, into a tensor, (1, 3, H, W)."""
        ordered = cut[..., ::-1] if self.red_first else cut
        np.copyto(tensor[0], ordered.transpose(2, 0, 1))
        if any(self.mean):
            tensor -= np.array(self.mean, np.float32)[:, None, None]
        if any(deviation != 1 for deviation in self.deviation):
            tensor *= (1.0 / np.array(self.deviation, np.float32))[:, None, None]
